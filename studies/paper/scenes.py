"""The figures that show the world: a scene with its LiDAR, and one run in four snapshots."""

from __future__ import annotations

import numpy as np
from crowdbench_studies.paper.plan import STORY
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon

from crowdbench.evaluation.apart import apart
from crowdbench.evaluation.episode import Episode
from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.recordings import find_recordings
from crowdbench.evaluation.scene import arena_picture
from crowdbench.scenario import load_scenario
from crowdbench.study.measurements import Measurements
from crowdbench.study.style import WIDTH

ROBOT, PERSON, OBSTACLE = "#D55E00", "#0072B2", "0.55"
SCENES = (("multimodal_fast", 0), ("corridor_very_dense", 2))
"""Scenario and seed of the scenes of Figure 3; they are shown after ``SCENE_STEPS``."""
SCENE_STEPS = 10
SNAPSHOTS = 4


def scene() -> Figure:
    """Figure 3: the open arena and the very dense corridor as the simulation draws them."""
    shown = [(load_scenario(name), seed) for name, seed in SCENES]
    heights = [scenario.arena.width / scenario.arena.length for scenario, _ in shown]
    figure = Figure(figsize=(WIDTH, WIDTH * sum(heights) + 0.2), layout="constrained")
    axes = figure.subplots(len(shown), 1, gridspec_kw={"height_ratios": heights})
    for axis, (scenario, seed) in zip(axes, shown, strict=True):
        length, width = scenario.arena.length / 2, scenario.arena.width / 2
        picture = apart(arena_picture, scenario, seed, SCENE_STEPS)
        # With its own alpha it is resampled in single precision, in half the memory.
        picture = np.dstack([picture, np.full(picture.shape[:2], 255, dtype=np.uint8)])
        axis.imshow(picture, extent=(-length, length, -width, width))
        axis.grid(visible=False)
        axis.set_ylabel("y [m]")
    axes[-1].set_xlabel("x [m]")
    return figure


def snapshots(measured: Measurements) -> Figure | None:
    """Figure 6: one run among people at four moments.

    Shown is, of the first stored runs of the plan's agent that arrived, the one that came nearest
    to a person; its moments are evenly spread around that encounter.

    Args:
        measured: the stored episodes.
    """
    found = [episode for episode in _stories(measured) if episode.outcome == "success"]
    if not found:
        return None
    episode = min(found, key=METRICS["min_clearance"].function)
    scenario = load_scenario(episode.scenario)
    figure = Figure(figsize=(WIDTH, WIDTH + 0.2), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    for number, (axis, step) in enumerate(zip(axes.flat, _moments(episode), strict=True)):
        _draw(axis, episode, step)
        time = step * episode.control_period
        axis.set_title(f"$t_{number}$ = {time:.1f} s", pad=2)
        axis.set_xlim(-scenario.arena.length / 2, scenario.arena.length / 2)
        axis.set_ylim(-scenario.arena.width / 2, scenario.arena.width / 2)
        axis.set_aspect("equal")
        axis.locator_params(nbins=3)
        axis.grid(visible=False)
    for axis in axes[1]:
        axis.set_xlabel("x [m]")
    for axis in axes[:, 0]:
        axis.set_ylabel("y [m]")
    entries = [
        Line2D([], [], color=ROBOT, marker="s", linestyle="", label="robot"),
        Line2D([], [], color=PERSON, marker="o", linestyle="", label="person"),
        Line2D([], [], color=ROBOT, marker="*", markersize=7, linestyle="", label="goal"),
        Line2D([], [], color="0.4", label="path so far"),
    ]
    figure.legend(handles=entries, loc="outside upper center", ncols=4, columnspacing=1.0)
    return figure


def _stories(measured: Measurements) -> list[Episode]:
    """The runs from which Figure 6 is chosen, simulated again."""
    scenario, agent, number = STORY
    rows = measured.episodes
    chosen = (rows["scenario"] == scenario) & (rows["agent"] == agent) & (rows["seed"] < number)
    return [
        episode
        for recording in find_recordings(rows[chosen])
        for seed in recording.seeds
        for episode in recording.episodes(seed)
    ]


def _moments(episode: Episode) -> np.ndarray:
    """Four steps, evenly spread around the nearest encounter, as far as the run reaches."""
    gaps = np.linalg.norm(
        episode.pedestrian_position - episode.robot_pose[:, None, :2], axis=2
    ).min(axis=1)
    nearest, last = int(np.argmin(gaps)), episode.steps
    half = min(max(nearest, last - nearest), last // 2)
    first = min(max(nearest - half, 0), last - 2 * half)
    return np.linspace(first, first + 2 * half, SNAPSHOTS).round().astype(int)


def _draw(axis: Axes, episode: Episode, step: int) -> None:
    """One moment: everybody where they are, with the paths that led there."""
    for x, y, radius in episode.obstacles:
        axis.add_patch(Circle((x, y), radius, color=OBSTACLE))
    for x1, y1, x2, y2 in episode.walls:
        axis.plot([x1, x2], [y1, y2], color="black", linewidth=1)
    start = max(0, step - round(4 / episode.control_period))  # the last four seconds
    for person, radius in enumerate(episode.pedestrian_radius):
        path = episode.pedestrian_position[start : step + 1, person]
        axis.plot(*path.T, color=PERSON, linewidth=0.7, alpha=0.6)
        axis.add_patch(Circle(path[-1], radius, color=PERSON))
    axis.plot(*episode.robot_pose[: step + 1, :2].T, color=ROBOT, linewidth=0.9)
    x, y, heading = episode.robot_pose[step]
    ahead, aside = (
        np.array([np.cos(heading), np.sin(heading)]),
        np.array([-np.sin(heading), np.cos(heading)]),
    )
    length, width = np.array(episode.footprint) / 2
    corners = [
        np.array([x, y]) + i * length * ahead + j * width * aside
        for i, j in ((1, 1), (-1, 1), (-1, -1), (1, -1))
    ]
    axis.add_patch(Polygon(corners, facecolor=ROBOT, edgecolor="black", linewidth=0.5, zorder=3))
    axis.plot(*episode.goal, color=ROBOT, marker="*", markersize=7, linestyle="")
