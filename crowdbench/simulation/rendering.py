"""Pictures of a scene, drawn from ``CrowdEnv.state()`` alone.

Colours are those of Okabe and Ito (2008), told apart with every common form of colour blindness;
whatever a colour says is said by a shape too: reactive pedestrians are filled discs, non-reactive
ones, and those who look away, are rings.
"""

from __future__ import annotations

import itertools
import os
import sys
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from crowdbench.robot import RobotSpec
from crowdbench.scenario import Scenario
from crowdbench.simulation.canvas import MARGIN, PAPER, WHITE, Brush, Color, Points, View
from crowdbench.simulation.window import Window

if TYPE_CHECKING:
    import pygame

BLACK, GREY = (0, 0, 0), (110, 110, 110)
GRID, OBSTACLE = (234, 234, 232), (135, 135, 135)
REACTIVE, NONREACTIVE = (0, 114, 178), (213, 94, 0)  # blue, vermilion
ROBOTS = ((0, 158, 115), (204, 121, 167), (230, 159, 0), (86, 180, 233))  # green, pink, orange, sky

PEDESTRIAN_TRAIL = 4.0
"""How long the trail behind a pedestrian is [s]."""


class Renderer:
    """Draws states of one scenario; trails are all it remembers."""

    def __init__(self, scenario: Scenario, mode: str) -> None:
        """Mode ``human`` opens a window with the first picture, ``rgb_array`` never does."""
        self._pygame = _import_pygame(window=mode == "human")
        self._mode = mode
        self._scenario = scenario
        self._spec = RobotSpec.from_scenario(scenario)
        arena = scenario.arena
        self._view = View(arena.length, arena.width, arena.centre)
        self._trails = _Trails()
        self._fonts: dict[int, pygame.font.Font] = {}
        self._window: Window | None = None
        self._clock = self._pygame.time.Clock()
        self._closed = False

    def draw(
        self, state: Mapping[str, NDArray[Any]], lidar: Mapping[str, NDArray[Any]]
    ) -> NDArray[np.uint8] | None:
        """Draw one state.

        Args:
            state: as returned by ``CrowdEnv.state()``; only read.
            lidar: the last scan (beams,) [m] of each robot to draw one for, by robot name.

        Returns:
            The picture (height, width, 3), or None in mode ``human``, where it goes to a window
            at real-time pace. Nothing more is drawn once that window has been closed.
        """
        if self._closed or (self._window and self._window.closed):
            return None
        self.follow(state)
        picture = self._paint(state, lidar)
        if self._mode == "rgb_array":
            pixels = self._pygame.surfarray.array3d(picture)
            return np.ascontiguousarray(pixels.transpose(1, 0, 2))
        self._show(picture)
        return None

    def follow(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take note of a state that is not drawn itself: later pictures show trails."""
        self._trails.add(state)

    def close(self) -> None:
        """Close the window, if there is one; nothing is drawn afterwards."""
        self._closed = True
        if self._window is not None:
            self._window.close()

    def _show(self, picture: pygame.Surface) -> None:
        if self._window is None:
            title = f"crowdbench: {self._scenario.name}"
            self._window = Window(self._pygame, title, self._view.size)
        self._window.show(picture)
        self._clock.tick(1 / self._scenario.control_period)

    def _paint(
        self, state: Mapping[str, NDArray[Any]], lidar: Mapping[str, NDArray[Any]]
    ) -> pygame.Surface:
        """Everything, from the floor up."""
        pygame, view = self._pygame, self._view
        brush = Brush(pygame, view)
        _draw_floor(brush, view)
        scans = [
            (index, _scan_points(state["robot_pose"][index], lidar[name], self._spec))
            for index, name in enumerate(f"robot_{i}" for i in range(len(state["robot_pose"])))
            if name in lidar and state["robot_active"][index]
        ]
        people = _present(state)
        _draw_pedestrian_goals(brush, people)
        self._trails.draw(brush, state)
        for index, points in scans:
            brush.glaze(points, _robot(index), share=0.14 if len(scans) == 1 else 0.07)
        for polygon in self._scenario.arena.polygons:
            brush.polygon(np.array(polygon), OBSTACLE)
        _draw_static(brush, state)
        _draw_robot_goals(brush, state, self._spec)
        _draw_groups(brush, people)
        _draw_pedestrians(brush, people)
        for index, points in scans:
            hits = lidar[f"robot_{index}"] < 0.999 * self._spec.lidar_range
            for point in points[-len(hits) :][hits]:
                brush.disc(point, 0.03, _mix(_robot(index), BLACK, 0.35))
        _draw_robots(brush, state, self._spec)
        picture = brush.finish()
        self._label(picture, state)
        return picture

    def _label(self, picture: pygame.Surface, state: Mapping[str, NDArray[Any]]) -> None:
        """Name and time above, scale bar and legend below."""
        pygame, (width, height) = self._pygame, self._view.size
        left, right, low = MARGIN, width - MARGIN, height - MARGIN // 2
        self._text(picture, self._scenario.name, (left, MARGIN // 2), 18, BLACK)
        self._text(picture, f"{float(state['time']):.1f} s", (right, MARGIN // 2), 18, BLACK, 1.0)
        bar = _scale_bar(self._scenario.arena.length)
        end = left + round(bar * self._view.scale)
        pygame.draw.line(picture, BLACK, (left, low), (end, low), 2)
        for x in (left, end):
            pygame.draw.line(picture, BLACK, (x, low - 4), (x, low + 4), 2)
        self._text(picture, f"{bar:g} m", (end + 8, low), 15, BLACK)
        kinds = _sees(state)
        x = right
        if (~kinds).any():
            x = self._legend(picture, "does not see the robot", (x, low), filled=False)
        if kinds.any():
            self._legend(picture, "sees the robot", (x, low), filled=True)

    def _legend(
        self, picture: pygame.Surface, text: str, end: tuple[int, int], filled: bool
    ) -> int:
        """Write one entry so that it ends at ``end``; return where the one before it may end."""
        x = end[0] - self._text(picture, text, end, 15, GREY, 1.0) - 14
        color = REACTIVE if filled else NONREACTIVE
        draw = self._pygame.draw
        draw.aacircle(picture, color, (x, end[1]), 7)
        if not filled:
            draw.aacircle(picture, PAPER, (x, end[1]), 4)
        return x - 24

    def _text(
        self,
        picture: pygame.Surface,
        text: str,
        at: tuple[int, int],
        size: int,
        color: Color,
        anchor: float = 0.0,
    ) -> int:
        """Write centred on the height of ``at``, ``anchor`` of it left of ``at``; return width."""
        if size not in self._fonts:
            self._fonts[size] = self._pygame.font.Font(None, round(1.25 * size))
        image = self._fonts[size].render(text, True, color)
        width, height = image.get_size()
        picture.blit(image, (at[0] - anchor * width, at[1] - height / 2))
        return width


class _Trails:
    """Where everybody has been since the episode began."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._robots: list[Points] = []
        self._pedestrians: list[Points] = []

    def add(self, state: Mapping[str, NDArray[Any]]) -> None:
        time = float(state["time"])
        if self._times and time <= self._times[-1]:
            if time == self._times[-1]:
                self._forget(len(self._times) - 1)
            else:
                self._forget(0)
        self._times.append(time)
        self._robots.append(np.array(state["robot_pose"][:, :2]))
        self._pedestrians.append(np.array(state["pedestrian_position"]))

    def _forget(self, keep: int) -> None:
        del self._times[keep:], self._robots[keep:], self._pedestrians[keep:]

    def draw(self, brush: Brush, state: Mapping[str, NDArray[Any]]) -> None:
        """Fading lines, oldest piece first."""
        now = self._times[-1]
        for step in range(1, len(self._times)):
            age = now - self._times[step]
            if age >= PEDESTRIAN_TRAIL:
                continue
            fade = 0.35 * (1 - age / PEDESTRIAN_TRAIL)
            pieces = zip(self._pedestrians[step - 1], self._pedestrians[step], strict=True)
            # Nobody walks farther; who does has left and entered anew.
            farthest = state["pedestrian_speed"] * (self._times[step] - self._times[step - 1]) + 0.5
            for (start, end), sees, most in zip(pieces, _sees(state), farthest, strict=True):
                if np.hypot(*(end - start)) <= most:
                    color = REACTIVE if sees else NONREACTIVE
                    brush.line(start, end, 0.05, _mix(WHITE, color, fade))
        for step in range(1, len(self._times)):
            for index, end in enumerate(self._robots[step]):
                brush.line(
                    self._robots[step - 1][index], end, 0.06, _mix(WHITE, _robot(index), 0.75)
                )


def _import_pygame(window: bool) -> Any:
    """Pygame, without its greeting; without a screen its dummy driver takes the window."""
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    screens = {"DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"}
    if window and sys.platform.startswith("linux") and not screens & os.environ.keys():
        os.environ["SDL_VIDEODRIVER"] = "dummy"
    import pygame

    pygame.font.init()
    return pygame


def _robot(index: int) -> Color:
    return ROBOTS[index % len(ROBOTS)]


def _sees(state: Mapping[str, NDArray[Any]]) -> NDArray[np.bool_]:
    """(P,) who sees robots now: the reactive ones who do not look away."""
    return np.asarray(state["pedestrian_reactive"] & state["pedestrian_attentive"])


def _mix(below: Color, above: Color, share: float) -> Color:
    """``share`` of one colour over another."""
    red, green, blue = (
        round((1 - share) * a + share * b) for a, b in zip(below, above, strict=True)
    )
    return red, green, blue


def _scale_bar(length: float) -> float:
    """The longest of 1, 2, 5, 10, ... m that takes at most a fifth of the arena's length."""
    steps = [m * 10.0**e for e in range(-2, 3) for m in (1, 2, 5)]
    return max([step for step in steps if step <= length / 5] or [steps[0]])


def _scan_points(pose: Points, scan: NDArray[Any], spec: RobotSpec) -> Points:
    """World positions where the beams end [m], after the LiDAR's unless it sees all around."""
    angles = pose[2] + spec.lidar_angles
    x, y, turn = spec.lidar_mount
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    lidar = pose[:2] + np.array([cosine * x - sine * y, sine * x + cosine * y])
    ends = lidar + scan[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    all_around = len(angles) > 2 and spec.lidar_angles[0] == turn
    return ends if all_around else np.vstack([lidar[None], ends])


def _draw_floor(brush: Brush, view: View) -> None:
    half = np.array([view.length, view.width]) / 2
    (left, low), (right, high) = view.centre - half, view.centre + half
    brush.polygon(np.array([[left, low], [right, low], [right, high], [left, high]]), WHITE)
    hair = 1.0 / view.scale
    spacing = _scale_bar(view.length) / 2
    for at in np.arange(np.ceil(left / spacing), np.floor(right / spacing) + 1) * spacing:
        brush.line(np.array([at, low]), np.array([at, high]), hair, GRID)
    for at in np.arange(np.ceil(low / spacing), np.floor(high / spacing) + 1) * spacing:
        brush.line(np.array([left, at]), np.array([right, at]), hair, GRID)


def _draw_static(brush: Brush, state: Mapping[str, NDArray[Any]]) -> None:
    for x, y, radius in state["obstacles"]:
        brush.disc(np.array([x, y]), radius, _mix(OBSTACLE, BLACK, 0.35))
        brush.disc(np.array([x, y]), radius - 0.03, OBSTACLE)
    for wall in state["walls"]:
        brush.line(wall[:2], wall[2:], 0.08, _mix(OBSTACLE, BLACK, 0.5))


def _present(state: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """What is known of the pedestrians who are there."""
    there = np.isfinite(state["pedestrian_position"][:, 0])
    names = ("position", "velocity", "way", "goal", "radius", "reactive", "attentive", "group")
    return {f"pedestrian_{name}": state[f"pedestrian_{name}"][there] for name in names}


def _draw_pedestrian_goals(brush: Brush, state: Mapping[str, NDArray[Any]]) -> None:
    """A faint cross where each pedestrian is going, and faint dots along what is known of its way.

    That is the way to the goal, or to the next region that it passes.
    """
    for position, way, goal, reactive in zip(
        state["pedestrian_position"],
        state["pedestrian_way"],
        state["pedestrian_goal"],
        _sees(state),
        strict=True,
    ):
        color = _mix(WHITE, REACTIVE if reactive else NONREACTIVE, 0.3)
        for first, last in _dots(np.vstack([position, way])):
            brush.line(first, last, 0.02, color)
        for diagonal in (np.array([0.1, 0.1]), np.array([0.1, -0.1])):
            brush.line(goal - diagonal, goal + diagonal, 0.035, color)


def _dots(line: NDArray[np.float64]) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Ends of short strokes, evenly spaced along a line (N, 2) [m]."""
    along = 0.0  # from the beginning of a part of the line to the next stroke
    for begin, end in itertools.pairwise(line):
        gap = float(np.hypot(*(end - begin)))
        while along < gap:
            ends = along / gap, min(along + 0.06, gap) / gap
            yield begin + ends[0] * (end - begin), begin + ends[1] * (end - begin)
            along += 0.3
        along -= gap


def _draw_groups(brush: Brush, state: Mapping[str, NDArray[Any]]) -> None:
    """Lines between the people of a group, from one to the next."""
    group, position = state["pedestrian_group"], state["pedestrian_position"]
    for p in np.flatnonzero((group[1:] == group[:-1]) & (group[1:] >= 0)).tolist():
        brush.line(position[p], position[p + 1], 0.05, GREY)


def _draw_pedestrians(brush: Brush, state: Mapping[str, NDArray[Any]]) -> None:
    for position, velocity, radius, reactive in zip(
        state["pedestrian_position"],
        state["pedestrian_velocity"],
        state["pedestrian_radius"],
        _sees(state),
        strict=True,
    ):
        color = REACTIVE if reactive else NONREACTIVE
        brush.disc(position, radius, color)
        if not reactive:
            brush.disc(position, 0.62 * radius, WHITE)
        speed = np.hypot(*velocity)
        if speed > 0.05:
            ahead = velocity / speed
            tip = position + (radius + 0.5 * speed) * ahead
            brush.line(position + radius * ahead, tip, 0.05, color)
            inner = WHITE if reactive else color
            brush.disc(position + 0.5 * radius * ahead, 0.22 * radius, inner)


def _draw_robot_goals(brush: Brush, state: Mapping[str, NDArray[Any]], spec: RobotSpec) -> None:
    for index, goal in enumerate(state["robot_goal"]):
        color = _robot(index)
        brush.disc(goal, spec.goal_tolerance, _mix(WHITE, color, 0.22))
        brush.ring(goal, spec.goal_tolerance, 0.035, color)
        brush.polygon(goal + 0.55 * spec.goal_tolerance * _STAR, color)


def _draw_robots(brush: Brush, state: Mapping[str, NDArray[Any]], spec: RobotSpec) -> None:
    """Footprint with an arrow for the heading; paler once the robot is done."""
    for index, (x, y, heading) in enumerate(state["robot_pose"]):
        color = _robot(index) if state["robot_active"][index] else _mix(WHITE, _robot(index), 0.45)
        cos, sin = np.cos(heading), np.sin(heading)
        turn = np.array([[cos, sin], [-sin, cos]])
        centre = np.array([x, y])
        brush.polygon(centre + spec.corners @ turn, _mix(color, BLACK, 0.55))
        inner = np.sign(spec.corners) * (np.abs(spec.corners) - 0.03)
        brush.polygon(centre + inner @ turn, color)
        arrow = np.array([[0.34, 0], [-0.22, 0.3], [-0.1, 0], [-0.22, -0.3]])
        brush.polygon(centre + arrow * (spec.length, spec.width) @ turn, WHITE)


_STAR = np.array(
    [
        [radius * np.sin(angle), radius * np.cos(angle)]
        for radius, angle in zip([1, 0.42] * 5, np.arange(10) * np.pi / 5, strict=True)
    ]
)
