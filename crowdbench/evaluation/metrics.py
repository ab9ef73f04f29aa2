"""Metrics: ``METRICS`` at the end says all that has to be known of each, one entry a metric.

Each is a pure function of an Episode, in ``navigation_metrics`` or ``social_metrics``;
docs/metrics.md has formulas and fixtures. A value that is not defined for an episode (the
smoothness of one action, a distance to pedestrians where there are none) is NaN and leaves that
episode out of the metric's mean.
"""

from __future__ import annotations

from collections.abc import Callable

from crowdbench.evaluation import navigation_metrics as navigation
from crowdbench.evaluation import social_metrics as social
from crowdbench.evaluation.episode import Episode
from crowdbench.evaluation.metric import Direction, Metric, MetricError
from crowdbench.registry import Registry, UnknownNameError


def metrics(episode: Episode) -> dict[str, float]:
    """Every metric of an episode by name, in the order of ``METRICS``.

    Raises:
        MetricError: one that cannot be computed.
        UnknownNameError: one of another package that cannot be loaded.
    """
    for name, metric in METRICS.items():
        if metric.weight and metric.weight not in METRICS:
            raise MetricError(f"metric {name!r}: weight: {METRICS.unknown(metric.weight)}")
    return {name: metric.measure(name, episode) for name, metric in METRICS.items()}


def _proportion(
    function: Callable[[Episode], float], better: Direction, definition: str, main: bool = False
) -> Metric:
    return Metric(function, "", better, definition, "proportion", main, digits=3)


def _share_of_steps(function: Callable[[Episode], float], what: str, main: bool = False) -> Metric:
    definition = f"share of steps {what}"
    return Metric(
        function, "", "lower", definition, "mean", main, printed_unit="%", scale=100, digits=1
    )


def _per_minute(function: Callable[[Episode], float], what: str) -> Metric:
    definition = f"per minute in the scene: {what}"
    return Metric(function, "1/min", "lower", definition, "mean", digits=2, weight="time_in_scene")


def _per_km(function: Callable[[Episode], float], what: str) -> Metric:
    definition = f"collisions per km driven {what}"
    return Metric(function, "1/km", "lower", definition, "mean", digits=1, weight="path_length")


def _by_chance(name: str, unit: str) -> Metric:
    function = social.disturbance(name, chance=True)
    definition = f"{name} of people whom a push of 1 mm has disturbed, and no robot"
    return Metric(function, unit, "lower", definition, "mean", digits=3)


_BUILT_IN = {
    "success": _proportion(
        navigation.success, "higher", "goal reached in time without any contact", main=True
    ),
    "spl": Metric(
        navigation.spl, "", "higher", "success weighted by shortest over driven path length",
        "mean", main=True, label="SPL", digits=3,
    ),
    "smoothness": Metric(
        navigation.smoothness, "m²/s² + rad²/s²", "lower", "mean squared change between actions",
        "mean", main=True, digits=3,
    ),
    "inference_s": Metric(
        navigation.inference_s, "s", "lower", "mean wall-clock time in act per step", "mean",
        main=True, label="inference", printed_unit="ms", scale=1000,
    ),
    "cutoff": Metric(
        social.cutoff, "events", "lower",
        "crossings ahead of a walking pedestrian with a gap below 2 s", "count", main=True,
        digits=2,
    ),
    "min_dist": Metric(
        social.min_dist, "m", "higher", "least distance to a pedestrian, centres", "mean",
        main=True, digits=3,
    ),
    "min_clearance": Metric(
        social.min_clearance, "m", "higher", "least distance to a pedestrian, surfaces", "mean",
        digits=3,
    ),
    "ttc_below_1s": _share_of_steps(
        social.ttc_below_1s, "with a time to collision below 1 s", main=True
    ),
    "collision_pedestrian": _proportion(
        navigation.collision_with("pedestrian"), "lower", "ended in contact with a pedestrian"
    ),
    "collision_obstacle": _proportion(
        navigation.collision_with("obstacle"), "lower", "ended in contact with a static obstacle"
    ),
    "collision_wall": _proportion(
        navigation.collision_with("wall"), "lower", "ended in contact with a wall"
    ),
    "collision_robot": _proportion(
        navigation.collision_with("robot"), "lower", "ended in contact with another robot"
    ),
    "robot_at_fault": _proportion(
        navigation.robot_at_fault, "lower", "of the collisions, those the robot drove into"
    ),
    "timeout": _proportion(navigation.timeout, "lower", "ended by the time limit"),
    "time_to_goal": Metric(
        navigation.time_to_goal, "s", "lower", "time until arrival, successes only", "mean",
        digits=1,
    ),
    "path_length": Metric(
        navigation.path_length, "m", "lower", "length of the driven path", "mean", digits=2
    ),
    "stalled_time": Metric(
        navigation.stalled_time, "s", "lower", "time slower than 0.05 m/s", "mean", digits=2
    ),
    "jerk": Metric(
        navigation.jerk, "m/s³", "lower", "mean second difference of the velocity vector", "mean",
        digits=2,
    ),
    "intimate_space_share": _share_of_steps(
        social.intimate_space_share, "within 0.45 m of a pedestrian, surfaces"
    ),
    "personal_space_share": _share_of_steps(
        social.personal_space_share, "within 1.2 m of a pedestrian, surfaces"
    ),
    "group_space_share": _share_of_steps(
        social.group_space_share, "among the people of a group that is together"
    ),
    "time_in_scene": Metric(
        navigation.time_in_scene, "s", "lower", "time until the end, however it came", "mean",
        digits=1,
    ),
    "cutoffs_per_min": _per_minute(
        social.cutoffs_per_min, "crossings ahead of a walking pedestrian with a gap below 2 s"
    ),
    "severe_cutoffs_per_min": _per_minute(
        social.severe_cutoffs_per_min, "the same with a gap below 1 s"
    ),
    "near_misses_per_min": _per_minute(
        social.near_misses_per_min,
        "approaches below 0.2 m at a closing speed above 0.5 m/s without contact",
    ),
    "collisions_caused_per_km": _per_km(
        navigation.collisions_caused_per_km, "in which the robot drove into the other"
    ),
    "collisions_suffered_per_km": _per_km(
        navigation.collisions_suffered_per_km, "in which the other came into the robot"
    ),
    "progress": Metric(
        navigation.progress, "", "higher", "share of the shortest path done at the end", "mean",
        digits=3,
    ),
    "stl": Metric(
        navigation.stl, "", "higher", "success weighted by fastest over needed time", "mean",
        label="STL", digits=3,
    ),
    "barn_score": Metric(
        navigation.barn_score, "", "higher",
        "success over the needed time in fastest ones, that between 2 and 8", "mean",
        label="BARN score", digits=3,
    ),
    "heading_changes": Metric(
        navigation.heading_changes, "rad", "lower", "turns added up, left and right", "mean",
        digits=2,
    ),
    "curvature": Metric(
        navigation.curvature, "rad/m", "lower", "turning of the driven path by its length", "mean",
        digits=2,
    ),
    "path_irregularity": Metric(
        navigation.path_irregularity, "rad/m", "lower",
        "turning beyond that of the shortest path by the length of the driven one", "mean",
        digits=2,
    ),
    "social_work": Metric(
        social.social_work, "m/s²", "lower",
        "mean social force between the robot and all others, after HuNavSim", "mean", digits=2,
    ),
    "delay": Metric(
        social.disturbance("delay"), "s", "lower",
        "mean time by which the robot has set people back on their ways, after 20 s", "mean",
        digits=3,
    ),
    "detour": Metric(
        social.disturbance("detour"), "m", "lower",
        "how much further the robot has made people walk to the same goals, in 20 s", "mean",
        digits=3,
    ),
    "displacement": Metric(
        social.disturbance("displacement"), "m", "lower",
        "largest mean distance by which the robot has shifted people, within 20 s", "mean",
        digits=3,
    ),
    "delay_by_chance": _by_chance("delay", "s"),
    "detour_by_chance": _by_chance("detour", "m"),
    "displacement_by_chance": _by_chance("displacement", "m"),
}  # fmt: skip


class _Metrics(Registry[Metric]):
    """Metrics share their tables with other columns, whose names SQL reads in either case."""

    def _checked(self, name: str, value: Metric) -> Metric:
        from crowdbench.evaluation.rows import COLUMNS

        taken = {other.lower(): other for other in (*COLUMNS, *self) if other != name}
        if name in COLUMNS or name.lower() in taken:
            raise UnknownNameError(
                f"metric {name!r}: the results have a column {taken.get(name.lower(), name)!r}; "
                "choose another name"
            )
        return super()._checked(name, value)


METRICS: Registry[Metric] = _Metrics("metric", "crowdbench.metrics", _BUILT_IN, of=Metric)
"""Every metric by name: crowdbench's own in the order of the tables, then those of packages."""
