"""What a study is made of: tables of methods by quantities, claims, figures, and their episodes.

A study is data. Which episodes it needs follows from it, and so do its tables and its page; nothing
here knows a result.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from crowdbench.agent import AgentSpec
from crowdbench.evaluation.metric import Metric
from crowdbench.evaluation.metrics import METRICS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from crowdbench.study.measurements import Measurements

EPISODES = 100
"""Per method and scenario, unless a method says otherwise; seeds 0, 1, ..."""


class StudyError(ValueError):
    """A study that cannot be found or used; the message names it, the field and what is known."""


@dataclass(frozen=True)
class Method:
    """A row of a table.

    Attributes:
        agent: with its options, as on the command line.
        label: as printed; by default the agent.
        episodes: per scenario.
        bound: a floor or ceiling, shown for orientation; it takes no part in comparisons.

    Raises:
        AgentError: an agent whose text cannot be read.
    """

    agent: str
    label: str = ""
    episodes: int = EPISODES
    bound: bool = False

    def __post_init__(self) -> None:
        """Name the agent as its episodes are stored."""
        object.__setattr__(self, "agent", str(AgentSpec.parse(self.agent)))
        object.__setattr__(self, "label", self.label or self.agent)


@dataclass(frozen=True)
class Quantity:
    """A metric and how tables print it.

    Attributes:
        metric: name in ``METRICS``.
        heading: as printed, with the unit; by default the metric's label and printed unit.
        digits: decimals in the printed unit; by default the metric's.
        rounding: half a unit of a reference value's last digit, in the stored unit.
        judged: whether orders and values are judged against the reference; not where they depend
            on the machine.
    """

    metric: str
    heading: str = ""
    digits: int | None = None
    rounding: float = 0.005
    judged: bool = True

    def __post_init__(self) -> None:
        """Fill in the heading; a metric that nothing has is refused where the study is read."""
        heading = self.metric
        if self.metric in METRICS:
            unit = METRICS[self.metric].printed_unit
            heading = METRICS[self.metric].title(self.metric) + (f" [{unit}]" if unit else "")
        object.__setattr__(self, "heading", self.heading or heading)

    @property
    def printed(self) -> Metric:
        """The metric, as this table prints it."""
        metric = METRICS[self.metric]
        return metric if self.digits is None else replace(metric, digits=self.digits)


@dataclass(frozen=True)
class Block:
    """Columns that belong together: scenarios, pooled if there are several.

    Attributes:
        scenarios: names or YAML files whose episodes count, all alike.
        heading: as printed; empty when a table has one block only.
    """

    scenarios: tuple[str, ...]
    heading: str = ""


@dataclass(frozen=True)
class Table:
    """One table of a study.

    Attributes:
        number: as printed and in the names of its files: letters and digits.
        title: what it shows.
        blocks, quantities, methods: see there.
        note: what a reader has to know, in one sentence or two.
        reference: values from elsewhere to show beside the measured ones, in the stored unit, by
            block heading, method label and metric; cells may be missing.
    """

    number: str
    title: str
    blocks: tuple[Block, ...]
    quantities: tuple[Quantity, ...]
    methods: tuple[Method, ...]
    note: str = ""
    reference: Mapping[tuple[str, str, str], float] = field(default_factory=dict, hash=False)


@dataclass(frozen=True)
class Claim:
    """That one agent is better than another, in a metric, over some scenarios.

    With x and y their means, the claim is x > factor y + margin where more is better, and
    x < factor y + margin where less is.

    Attributes:
        text: the claim in words; claims that differ in the metric only may share it.
        table: number of the table that holds its episodes; its claims are corrected together.
        better, worse: agents.
        scenarios: of that table; their episodes count alike.
        metric: name in ``METRICS``.
        factor, margin: see above; 1 and 0 for a plain order.

    Raises:
        AgentError: an agent whose text cannot be read.
    """

    text: str
    table: str
    better: str
    worse: str
    scenarios: tuple[str, ...]
    metric: str
    factor: float = 1.0
    margin: float = 0.0

    def __post_init__(self) -> None:
        """Name agents as their episodes are stored."""
        for name in ("better", "worse"):
            object.__setattr__(self, name, str(AgentSpec.parse(getattr(self, name))))


class Drawing(NamedTuple):
    """One figure of a study.

    Attributes:
        name: of its files, without ending.
        title, caption: as printed.
        draw: makes it from the measurements and the results folder; None if it has no data yet.
    """

    name: str
    title: str
    caption: str
    draw: Callable[[Measurements, Path], Figure | None]


class Cell(NamedTuple):
    """What has to be run for one agent in one scenario: seeds 0 to ``episodes`` - 1."""

    scenario: str
    agent: str
    episodes: int


@dataclass(frozen=True)
class Study:
    """What is compared, where, and what is claimed of it.

    Attributes:
        name: of its folder: letters, digits, ``-`` and ``_``.
        title: of its page.
        tables, claims, figures: see there.
        more: episodes that figures need beyond those of the tables.
        source: whose the tables' reference values are, e.g. ``the paper``.
        introduction: what the page begins with, in Markdown.
        reading: what a reader has to know, in Markdown.
        shown: numbers of the tables and names of the figures that the page shows; it links the
            others. Empty for all.
    """

    name: str
    title: str
    tables: tuple[Table, ...]
    claims: tuple[Claim, ...] = ()
    figures: tuple[Drawing, ...] = ()
    more: tuple[Cell, ...] = ()
    source: str = "the reference"
    introduction: str = ""
    reading: str = ""
    shown: tuple[str, ...] = ()

    def cells(self) -> list[Cell]:
        """Everything that tables and figures need, each cell once, grouped by agent.

        Raises:
            StudyError: one cell with different numbers of episodes.
        """
        needed: dict[tuple[str, str], int] = {}
        for cell in (*self._table_cells(), *self.more):
            before = needed.setdefault((cell.agent, cell.scenario), cell.episodes)
            if before != cell.episodes:
                raise StudyError(
                    f"agent {cell.agent!r} in scenario {cell.scenario!r} has {before} episodes in "
                    f"one place and {cell.episodes} in another; expected one number"
                )
        agents = list(dict.fromkeys(agent for agent, _ in needed))
        return sorted(
            (Cell(scenario, agent, episodes) for (agent, scenario), episodes in needed.items()),
            key=lambda cell: agents.index(cell.agent),
        )

    def _table_cells(self) -> list[Cell]:
        return [
            Cell(scenario, method.agent, method.episodes)
            for table in self.tables
            for block in table.blocks
            for method in table.methods
            for scenario in block.scenarios
        ]
