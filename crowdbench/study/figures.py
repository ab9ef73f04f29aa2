"""Every figure: what it is called, what it shows, and how it gets onto the disk."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
from matplotlib.figure import Figure

from crowdbench.study import charts, scenes
from crowdbench.study.measurements import Measurements
from crowdbench.study.style import LOOK


class Drawing(NamedTuple):
    """One figure of the results.

    Attributes:
        name: of its files, without ending.
        title, caption: as printed.
        draw: makes it from the measurements and the results folder; None if it has no data yet.
    """

    name: str
    title: str
    caption: str
    draw: Callable[[Measurements, Path], Figure | None]


DRAWINGS = (
    Drawing(
        "figure_3_scene",
        "Figure 3",
        "The open arena and the very dense corridor as the simulation draws them. Green: robot, "
        "its LiDAR scan and its goal (star); blue: people who see the robot, with a faint line to "
        "where each is going; grey: obstacles.",
        lambda measured, folder: scenes.scene(),
    ),
    Drawing(
        "figure_4_corridors",
        "Figure 4",
        "Success and SPL over the density of the corridor, with 95 % intervals. Markers of one "
        "density stand side by side so that the intervals can be told apart.",
        lambda measured, folder: charts.corridors(measured),
    ),
    Drawing(
        "figure_5_training",
        "Figure 5",
        "Success on validation episodes (all scenarios, no planning) while training, over "
        "environment steps and over wall time, demonstrations included.",
        lambda measured, folder: charts.training(folder / "training"),
    ),
    Drawing(
        "figure_6_run",
        "Figure 6",
        "One run of the planner (H=6, E=1) among people, simulated, at four moments around its "
        "nearest encounter. Of the first ten runs in multimodal_fast it is the successful one "
        "that came nearest to a person.",
        lambda measured, folder: scenes.snapshots(folder),
    ),
    Drawing(
        "figure_reactivity",
        "Reactivity",
        "How much success each method loses when people no longer react to the robot: paired "
        "difference on the same seeds between the scenarios of Table I and those of Table II, "
        "with 95 % intervals. The paper has no such figure; its tables imply the crosses.",
        lambda measured, folder: charts.reactivity(measured),
    ),
)


def save_figures(measured: Measurements, source: Path, target: Path) -> dict[str, bool]:
    """Draw every figure that has data, as PDF and PNG, the same bytes for the same data.

    Args:
        measured: the stored episodes.
        source: results folder with training curves and trajectories.
        target: folder of the files; a figure without data is removed from it.

    Returns:
        For each name whether there is a figure.
    """
    target.mkdir(parents=True, exist_ok=True)
    there = {}
    for drawing in DRAWINGS:
        with mpl.rc_context(LOOK):
            figure = drawing.draw(measured, source)
            there[drawing.name] = figure is not None
            pdf, png = (target / f"{drawing.name}.{ending}" for ending in ("pdf", "png"))
            if figure is None:
                pdf.unlink(missing_ok=True)
                png.unlink(missing_ok=True)
            else:
                figure.savefig(pdf, metadata={"CreationDate": None, "Producer": None})
                figure.savefig(png, metadata={"Software": None})
    return there
