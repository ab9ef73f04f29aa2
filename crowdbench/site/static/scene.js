"use strict";
// One moment of an episode on a canvas, in the colours of Okabe and Ito. What a colour says, a
// shape says too: people who see the robot are discs, people who do not are rings.
(function (crowdbench) {
  const GREEN = "#009e73", PINK = "#cc79a7", ORANGE = "#e69f00", SKY = "#56b4e9";
  const BLUE = "#0072b2", VERMILION = "#d55e00";
  const OTHERS = [PINK, ORANGE, SKY];
  const TRAIL = 4; // how long the trail behind a person is [s]
  const SHOWN = 1; // how long an event is marked on the scene [s]
  const MARGIN = 0.3; // around the arena [m]

  function colours() {
    const style = getComputedStyle(document.documentElement);
    const read = (name) => style.getPropertyValue(name).trim();
    const names = ["floor", "grid", "ink", "solid", "path"];
    return Object.fromEntries(names.map((name) => [name, read("--" + name)]));
  }

  // Half the length and width of what is shown [m]; without a definition, of what moves.
  function extent(episode, scenario) {
    if (scenario && scenario.arena) return scenario.arena.map((side) => side / 2 + MARGIN);
    const bound = (offset) => {
      let most = Math.abs(episode.goal[offset]);
      for (let i = offset; i < episode.position.length; i += 2) {
        most = Math.max(most, Math.abs(episode.position[i]) || 0); // NaN where nobody is
      }
      for (let i = offset; i < episode.pose.length; i += 3) {
        most = Math.max(most, Math.abs(episode.pose[i]));
      }
      return most + 0.5 + MARGIN;
    };
    return [bound(0), bound(1)];
  }

  crowdbench.Scene = class {
    constructor(canvas, episode, scenario) {
      this.canvas = canvas;
      this.episode = episode;
      this.lidar = (scenario && scenario.lidar) || null;
      this.half = extent(episode, scenario);
      this.centre = (scenario && scenario.centre) || [0, 0];
      this.solids = (scenario && scenario.solids) || [];
      canvas.style.aspectRatio = `${this.half[0]} / ${this.half[1]}`;
      this.frame = null; // as drawn last
    }

    // Canvas pixels of a place [m].
    project(x, y) {
      const { width, height } = this.canvas;
      const [cx, cy] = this.centre;
      return [width / 2 + (x - cx) * this.scale, height / 2 - (y - cy) * this.scale];
    }

    draw(time, shown) {
      const { canvas, episode } = this;
      const ratio = window.devicePixelRatio || 1;
      const width = Math.max(1, Math.round(canvas.clientWidth * ratio));
      const height = Math.max(1, Math.round((width * this.half[1]) / this.half[0]));
      if (canvas.width !== width || canvas.height !== height) {
        canvas.width = width;
        canvas.height = height;
      }
      this.scale = width / (2 * this.half[0]);
      this.context = canvas.getContext("2d");
      this.theme = colours();
      const frame = crowdbench.frame(episode, time);
      this.frame = frame;
      const people = frame.people.filter(crowdbench.isThere);
      this.floor();
      if (shown.goals) for (const person of people) this.goalOf(person);
      if (shown.trails) this.trails(frame);
      this.scan = shown.lidar && this.lidar ? crowdbench.scan(episode, frame, this.lidar) : null;
      if (this.scan) this.fan(frame);
      for (const corners of this.solids) this.polygon(corners, this.theme.solid);
      for (const [x, y, radius] of episode.obstacles) this.disc(x, y, radius, this.theme.solid);
      for (const [x1, y1, x2, y2] of episode.walls) this.line([[x1, y1], [x2, y2]], 0.08, this.theme.solid);
      this.robotGoal();
      for (const person of people) this.person(person);
      if (this.scan) this.hits(frame);
      frame.others.forEach((pose, i) => this.robot(pose, OTHERS[i % OTHERS.length]));
      this.robot(frame.robot, GREEN);
      if (shown.intents) for (const person of people) this.intent(person, frame.time);
      this.events(frame, shown);
    }

    floor() {
      const { context, canvas, theme } = this;
      context.fillStyle = theme.floor;
      context.fillRect(0, 0, canvas.width, canvas.height);
      const [left, low] = this.centre.map((at, i) => at - this.half[i]);
      const [right, high] = this.centre.map((at, i) => at + this.half[i]);
      for (let x = Math.ceil(left); x <= right; x++) {
        this.line([[x, low], [x, high]], 1 / this.scale, theme.grid);
      }
      for (let y = Math.ceil(low); y <= high; y++) {
        this.line([[left, y], [right, y]], 1 / this.scale, theme.grid);
      }
    }

    colourOf(person) {
      return person.sees === false ? VERMILION : BLUE;
    }

    // Fainter things of people: lighter than the people themselves where the floor is dark.
    pathColourOf(person) {
      return person.sees === false ? VERMILION : this.theme.path;
    }

    goalOf(person) {
      const [x, y] = person.goal;
      const colour = this.pathColourOf(person);
      this.context.globalAlpha = 0.7;
      this.line([person.position, person.goal], 0.02, colour, [0.06, 0.24]);
      this.line([[x - 0.1, y - 0.1], [x + 0.1, y + 0.1]], 0.035, colour);
      this.line([[x - 0.1, y + 0.1], [x + 0.1, y - 0.1]], 0.035, colour);
      this.context.globalAlpha = 1;
    }

    trails(frame) {
      const { episode, context } = this;
      const first = Math.max(0, Math.ceil((frame.time - TRAIL) / episode.period));
      frame.people.forEach((person, p) => {
        const path = [];
        for (let state = first; state <= frame.state; state++) {
          if (path.length && crowdbench.enters(episode, p, state)) path.length = 0;
          const index = 2 * (state * episode.people + p);
          path.push([episode.position[index], episode.position[index + 1]]);
        }
        context.globalAlpha = 0.45;
        this.line([...path, person.position], 0.05, this.pathColourOf(person));
      });
      const driven = [];
      for (let state = 0; state <= frame.state; state++) {
        driven.push([episode.pose[3 * state], episode.pose[3 * state + 1]]);
      }
      context.globalAlpha = 0.75;
      this.line([...driven, frame.robot], 0.06, GREEN);
      context.globalAlpha = 1;
    }

    ends(frame) {
      const [x, y, heading] = crowdbench.sensor(frame.robot, this.lidar);
      return crowdbench.beams(this.lidar).map((angle, i) => [
        x + this.scan[i] * Math.cos(heading + angle), y + this.scan[i] * Math.sin(heading + angle)]);
    }

    fan(frame) {
      const ends = this.ends(frame);
      this.context.globalAlpha = 0.14;
      this.polygon(this.lidar.degrees >= 360 ? ends : [crowdbench.sensor(frame.robot, this.lidar), ...ends], GREEN);
      this.context.globalAlpha = 1;
    }

    hits(frame) {
      this.ends(frame).forEach(([x, y], i) => {
        if (this.scan[i] < 0.999 * this.lidar.range) this.disc(x, y, 0.03, "#00674b");
      });
    }

    robotGoal() {
      const { goal: [x, y], tolerance } = this.episode;
      this.context.globalAlpha = 0.25;
      this.disc(x, y, tolerance, GREEN);
      this.context.globalAlpha = 1;
      this.ring(x, y, tolerance, 0.035, GREEN);
      this.polygon(Array.from({ length: 10 }, (_, i) => {
        const radius = 0.55 * tolerance * (i % 2 ? 0.42 : 1);
        return [x + radius * Math.sin((i * Math.PI) / 5), y + radius * Math.cos((i * Math.PI) / 5)];
      }), GREEN);
    }

    person(person) {
      const [x, y] = person.position;
      const { radius } = person;
      const colour = this.colourOf(person);
      const ring = person.sees === false;
      this.disc(x, y, radius, colour);
      if (ring) this.disc(x, y, 0.62 * radius, this.theme.floor);
      const speed = Math.hypot(...person.velocity);
      if (speed <= 0.05) return;
      const [ax, ay] = person.velocity.map((v) => v / speed);
      const tip = radius + 0.5 * speed;
      this.line([[x + radius * ax, y + radius * ay], [x + tip * ax, y + tip * ay]], 0.05, colour);
      this.disc(x + 0.5 * radius * ax, y + 0.5 * radius * ay, 0.22 * radius, ring ? colour : "#fff");
    }

    robot(pose, colour) {
      const [x, y, heading] = pose;
      const [length, width] = this.episode.footprint;
      this.polygon(crowdbench.corners(pose, [length, width]), "#0b3d30");
      this.polygon(crowdbench.corners(pose, [length - 0.06, width - 0.06]), colour);
      const [c, s] = [Math.cos(heading), Math.sin(heading)];
      this.polygon([[0.34, 0], [-0.22, 0.3], [-0.1, 0], [-0.22, -0.3]].map(([i, j]) =>
        [x + c * i * length - s * j * width, y + s * i * length + c * j * width]), "#fff");
    }

    // A person who is going to give up the goal, and when.
    intent(person, time) {
      if (person.intent === "keep" || person.switchTime === null || person.switchTime < time) return;
      const [x, y] = person.position;
      this.ring(x, y, person.radius + 0.1, 0.04, PINK, [0.1, 0.08]);
      const left = (person.switchTime - time).toFixed(1);
      this.text(`${person.intent === "return" ? "turns back" : "new goal"} in ${left} s`,
        x, y + person.radius + 0.3, PINK);
    }

    // Who is concerned by what happens now or happened just before.
    events(frame, shown) {
      const { episode } = this;
      for (const event of episode.events) {
        const since = frame.time - event.first * episode.period;
        const until = event.kind === "ttc" ? (event.last - event.first) * episode.period : SHOWN;
        const now = since > -1e-6 && since < until + 1e-6;
        if (!now || (event.kind === "switch" && !shown.intents)) continue;
        const colour = { cutoff: ORANGE, ttc: SKY, switch: PINK, collision: VERMILION }[event.kind];
        const ended = event.kind === "collision";
        if (!colour || (event.pedestrian === null && !ended)) continue;
        const { position: [x, y], radius } = event.pedestrian === null
          ? { position: frame.robot, radius: Math.hypot(...episode.footprint) / 2 }
          : frame.people[event.pedestrian];
        this.ring(x, y, radius + (event.kind === "ttc" ? 0.1 : 0.18), ended ? 0.09 : 0.06, colour);
      }
    }

    path(points) {
      const { context } = this;
      context.beginPath();
      points.forEach(([x, y], i) => context[i ? "lineTo" : "moveTo"](...this.project(x, y)));
    }

    line(points, width, colour, dashes) {
      const { context, scale } = this;
      this.path(points);
      context.strokeStyle = colour;
      context.lineWidth = Math.max(1, width * scale);
      context.lineCap = dashes ? "butt" : "round";
      context.lineJoin = "round";
      context.setLineDash((dashes || []).map((length) => length * scale));
      context.stroke();
    }

    polygon(points, colour) {
      this.path(points);
      this.context.fillStyle = colour;
      this.context.fill();
    }

    disc(x, y, radius, colour) {
      const { context } = this;
      context.beginPath();
      context.arc(...this.project(x, y), Math.max(1, radius * this.scale), 0, 2 * Math.PI);
      context.fillStyle = colour;
      context.fill();
    }

    ring(x, y, radius, width, colour, dashes) {
      const { context, scale } = this;
      context.beginPath();
      context.arc(...this.project(x, y), radius * scale, 0, 2 * Math.PI);
      context.strokeStyle = colour;
      context.lineWidth = Math.max(1.5, width * scale);
      context.lineCap = "butt";
      context.setLineDash((dashes || []).map((length) => length * scale));
      context.stroke();
    }

    text(text, x, y, colour) {
      const { context, theme } = this;
      const size = Math.max(11 * (window.devicePixelRatio || 1), 0.26 * this.scale);
      context.font = `600 ${size}px system-ui, sans-serif`;
      context.textAlign = "center";
      context.setLineDash([]);
      context.lineWidth = size / 4;
      context.lineJoin = "round";
      context.strokeStyle = theme.floor;
      context.strokeText(text, ...this.project(x, y));
      context.fillStyle = colour === PINK ? theme.ink : colour;
      context.fillText(text, ...this.project(x, y));
    }
  };
})(window.crowdbench);
