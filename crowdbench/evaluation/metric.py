"""What a metric is: one entry, from which intervals, tables, pages and messages follow.

A package adds one in a single file and one line of its metadata: ``docs/add_a_metric.md``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from crowdbench.evaluation.episode import Episode

Direction = Literal["higher", "lower"]
Kind = Literal["proportion", "mean", "count"]
ARROWS: dict[Direction, str] = {"higher": "↑", "lower": "↓"}

_NOTHING = 1e-12
"""Below this a number is zero but for rounding."""


def mean(values: NDArray[np.floating] | NDArray[np.bool_]) -> float:
    """The mean of an array, NaN where there is nothing."""
    return float(values.mean()) if values.size else math.nan


class MetricError(ValueError):
    """A metric that is declared wrong or cannot be computed; the message says which and where."""


@dataclass(frozen=True)
class Metric:
    """A number that an episode yields, and all that has to be known of it.

    Attributes:
        function: computes it; NaN where it is not defined.
        unit: of what ``function`` returns, empty for shares.
        better: the direction of improvement.
        definition: one line.
        kind: ``proportion`` if every episode yields 0 or 1, so that the mean is a share of
            episodes; ``count`` for a whole number of events; ``mean`` for any other quantity.
        main: whether it is shown where no metric is asked for.
        label: as pages and tables print it, by default the name with spaces; the command line
            prints the name, which it also takes.
        printed_unit: by default ``unit``.
        scale: factor from ``unit`` to ``printed_unit``.
        digits: decimals in ``printed_unit``; None for two significant digits.
        weight: for a rate, the name of the metric that it is per: an episode counts in the mean by
            that, so that the mean is all events over all of the time or way. Empty for the rest.

    Raises:
        MetricError: a field that says none of what is allowed.
    """

    function: Callable[[Episode], float]
    unit: str
    better: Direction
    definition: str
    kind: Kind
    main: bool = False
    label: str = ""
    printed_unit: str = ""
    scale: float = 1.0
    digits: int | None = None
    weight: str = ""

    def __post_init__(self) -> None:
        for field, value, allowed in (
            ("better", self.better, get_args(Direction)),
            ("kind", self.kind, get_args(Kind)),
        ):
            if value not in allowed:
                raise MetricError(f"{field}: expected {' or '.join(allowed)}, got {value!r}")
        if not (math.isfinite(self.scale) and self.scale > 0):
            raise MetricError(f"scale: expected a number > 0, got {self.scale!r}")
        if self.weight and self.kind != "mean":
            raise MetricError(f"weight: expected none for a {self.kind}, got {self.weight!r}")
        object.__setattr__(self, "printed_unit", self.printed_unit or self.unit)

    @property
    def arrow(self) -> str:
        """Where better is."""
        return ARROWS[self.better]

    def measure(self, name: str, episode: Episode) -> float:
        """Its value for an episode, in ``unit``.

        Raises:
            MetricError: the function failed, or returned what this kind of metric cannot be; the
                message names the metric and the episode.
        """
        where = f"metric {name!r}, {episode.scenario}, seed {episode.seed}, {episode.robot}"
        try:
            value = float(self.function(episode))
        except Exception as error:
            raise MetricError(f"{where}: {type(error).__name__}: {error}") from error
        if self.kind == "proportion" and value not in (0.0, 1.0) and not math.isnan(value):
            raise MetricError(f"{where}: a proportion is 0 or 1 for each episode, not {value:g}")
        return value

    def title(self, name: str) -> str:
        """The label, or what stands in its place."""
        return self.label or name.replace("_", " ")

    def number(self, value: float, beside: float | None = None) -> str:
        """A value as printed, without the unit.

        Args:
            value: in ``unit``.
            beside: whose decimals it shares, as the limits of an interval share the mean's; by
                default its own.
        """
        decimals = self.digits
        if decimals is None:
            size = abs(value if beside is None else beside) * self.scale
            decimals = max(0, 1 - math.floor(math.log10(size))) if size > _NOTHING else 0
        return f"{value * self.scale:z.{decimals}f}"
