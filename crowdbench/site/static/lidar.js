"use strict";
// The robot's LiDAR, cast again from the positions: stored scans would be several times the size of
// everything else. True distances; a scenario's noise and dropout are not drawn.
(function (crowdbench) {
  function circle(x, y, dx, dy, radius) {
    const along = x * dx + y * dy;
    const inside = along * along - (x * x + y * y) + radius * radius;
    if (x * x + y * y <= radius * radius) return 0;
    return inside >= 0 && along > 0 ? along - Math.sqrt(inside) : Infinity;
  }

  function segment(x1, y1, x2, y2, dx, dy) {
    const across = dx * (y2 - y1) - dy * (x2 - x1);
    if (across === 0) return Infinity;
    const hit = (x1 * (y2 - y1) - y1 * (x2 - x1)) / across;
    const share = (x1 * dy - y1 * dx) / across;
    return hit >= 0 && share >= -1e-12 && share <= 1 + 1e-12 ? hit : Infinity;
  }

  // Where a LiDAR is, and its heading [rad], on a robot at a pose.
  crowdbench.sensor = function ([x, y, heading], { mount: [ahead, left, turn] }) {
    const [c, s] = [Math.cos(heading), Math.sin(heading)];
    return [x + c * ahead - s * left, y + s * ahead + c * left, heading + turn];
  };

  // Directions of the beams from the LiDAR's heading [rad]: a full circle from ahead, else right to left.
  crowdbench.beams = function ({ beams, degrees }) {
    const view = (degrees * Math.PI) / 180;
    return Array.from({ length: beams }, (_, i) => {
      if (degrees >= 360) return (i * 2 * Math.PI) / beams;
      return beams > 1 ? -view / 2 + (i * view) / (beams - 1) : 0;
    });
  };

  // Distances [m] along the beams in a frame of an episode.
  crowdbench.scan = function (episode, frame, lidar) {
    const [x, y, heading] = crowdbench.sensor(frame.robot, lidar);
    const circles = [
      ...frame.people.filter(crowdbench.isThere)
        .map(({ position: [px, py], radius }) => [px - x, py - y, radius]),
      ...episode.obstacles.map(([ox, oy, radius]) => [ox - x, oy - y, radius]),
    ];
    const edges = frame.others.flatMap((pose) => {
      const corners = crowdbench.corners(pose, episode.footprint);
      return corners.map(([ax, ay], i) => [ax, ay, ...corners[(i + 1) % 4]]);
    });
    const segments = [...episode.walls, ...edges].map(([x1, y1, x2, y2]) =>
      [x1 - x, y1 - y, x2 - x, y2 - y]);
    return crowdbench.beams(lidar).map((angle) => {
      const [dx, dy] = [Math.cos(heading + angle), Math.sin(heading + angle)];
      let nearest = lidar.range;
      for (const [cx, cy, r] of circles) nearest = Math.min(nearest, circle(cx, cy, dx, dy, r));
      for (const s of segments) nearest = Math.min(nearest, segment(...s, dx, dy));
      return nearest;
    });
  };

  // Corners of a footprint [length, width] at a pose, counter-clockwise.
  crowdbench.corners = function ([x, y, heading], [length, width]) {
    const [c, s] = [Math.cos(heading), Math.sin(heading)];
    return [[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([i, j]) => {
      const [ahead, left] = [(i * length) / 2, (j * width) / 2];
      return [x + c * ahead - s * left, y + s * ahead + c * left];
    });
  };
})(window.crowdbench);
