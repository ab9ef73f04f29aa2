"""The paper's figures: what they are called and what they show."""

from __future__ import annotations

from crowdbench_studies.paper import charts, scenes

from crowdbench.study import Drawing

DRAWINGS = (
    Drawing(
        "figure_3_scene",
        "Figure 3",
        "The open arena and the very dense corridor as the simulation draws them. Green: robot, "
        "its LiDAR scan and its goal (star); blue: reactive pedestrians, with a faint line to "
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
        "One run of the planner (H=6, E=1) among pedestrians, simulated, at four moments around "
        "its nearest encounter. Of the first ten runs in multimodal_fast it is the successful one "
        "that came nearest to a pedestrian.",
        lambda measured, folder: scenes.snapshots(measured),
    ),
    Drawing(
        "figure_reactivity",
        "Reactivity",
        "How much success each method loses when pedestrians no longer react to the robot: paired "
        "difference on the same seeds between the scenarios of Table I and those of Table II, "
        "with 95 % intervals. The paper has no such figure; its tables imply the crosses.",
        lambda measured, folder: charts.reactivity(measured),
    ),
)
