"""What is measured: every table as data, from which the runs and the layouts follow.

A table is methods (an agent with its options) by quantities, in blocks of scenarios. Nothing here
knows a result.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from crowdbench.study.paper import PaperKey

CHEAP, COSTLY = 500, 100
"""Episodes per cell, on seeds 0, 1, ...: planners that plan anew at every step get fewer."""


@dataclass(frozen=True)
class Method:
    """A row of a table.

    Attributes:
        label: as printed.
        agent: the agent with its options, as stored with each episode.
        paper: the method's name in ``paper_tables.csv``; None for rows the paper does not have.
        episodes: per scenario.
        bound: a floor or ceiling, shown for orientation; it takes no part in comparisons.
    """

    label: str
    agent: str
    paper: str | None = None
    episodes: int = CHEAP
    bound: bool = False


@dataclass(frozen=True)
class Quantity:
    """A metric and how tables print it.

    Attributes:
        metric: name in ``METRICS``.
        heading: as printed, with the unit.
        paper: name in ``paper_tables.csv``.
        digits: decimals; None for two significant digits.
        scale: factor from the stored unit to the printed one.
        paper_scale: factor from the paper's unit to the stored one.
        rounding: half a unit of the paper's last digit, in the stored unit.
    """

    metric: str
    heading: str
    paper: str
    digits: int | None = 2
    scale: float = 1.0
    paper_scale: float = 1.0
    rounding: float = 0.005


class Block(NamedTuple):
    """Columns that belong together: scenarios, pooled if there are several.

    Attributes:
        heading: as printed; empty when a table has one block only.
        scenarios: whose episodes count, each with the same weight.
        paper: scenario and pedestrians in ``paper_tables.csv``.
    """

    heading: str
    scenarios: tuple[str, ...]
    paper: tuple[str, str]


@dataclass(frozen=True)
class Table:
    """One of the paper's tables.

    Attributes:
        number: the paper's, in Roman numerals.
        title: what it shows.
        blocks, quantities, methods: see there.
        note: what a reader has to know, in one sentence or two.
    """

    number: str
    title: str
    blocks: tuple[Block, ...]
    quantities: tuple[Quantity, ...]
    methods: tuple[Method, ...]
    note: str = ""

    def key(self, block: Block, method: Method, quantity: Quantity) -> PaperKey | None:
        """Where the paper has this cell's number; None for a method it does not have."""
        if method.paper is None:
            return None
        return PaperKey(self.number, *block.paper, method.paper, quantity.paper)


MOTIONS = {
    "unimodal_slow": "Uni-modal, slow",
    "unimodal_fast": "Uni-modal, fast",
    "multimodal_slow": "Multi-modal, slow",
    "multimodal_fast": "Multi-modal, fast",
}
CORRIDORS = ("corridor_sparse", "corridor_moderate", "corridor_dense", "corridor_very_dense")

SUCCESS = Quantity("success", "Success", "success")
SPL = Quantity("spl", "SPL", "spl")
SMOOTH = Quantity("smoothness", "Smooth", "smoothness")
INFERENCE = Quantity(
    "inference_s", "Inference [ms]", "inference_s", digits=None, scale=1000, rounding=0.0005
)
CUTOFF = Quantity("cutoff", "CutOff [1/ep.]", "cutoff_per_episode")
MIN_DIST = Quantity("min_dist", "MinDist [m]", "min_dist_m")
TTC = Quantity(
    "ttc_below_1s", "TTC < 1 s [%]", "ttc_below_1s_percent",
    digits=1, scale=100, paper_scale=0.01, rounding=0.0005,
)  # fmt: skip

OURS = "latent_planner"
OPEN_LOOP = "latent_planner:execute=6"
OTHERS = (
    Method("ORCA", "orca"),
    Method("Dynamic window", "dynamic_window"),
    Method("Straight line (floor)", "straight_line", bound=True),
    Method("Informed (ceiling)", "informed", bound=True),
)
COMPARED = (
    Method("NeuPAN", "neupan", "neupan"),
    Method("SAC", "sac", "sac"),
    Method("TD-MPC-style", "tdmpc", "tdmpc", COSTLY),
    Method("Ours, H=6, E=6", OPEN_LOOP, "latent_planner H=6 E=6"),
    Method("Ours, H=6, E=1", OURS, "latent_planner H=6 E=1", COSTLY),
    *OTHERS,
)
VERY_DENSE = (Block("", ("corridor_very_dense",), ("corridor_very_dense", "unspecified")),)
REACTIVE = tuple(MOTIONS)
NONREACTIVE = tuple(f"{name}_nonreactive" for name in MOTIONS)


def _open(number: str, title: str, suffix: str, pedestrians: str) -> Table:
    blocks = tuple(
        Block(heading, (name + suffix,), (name, pedestrians)) for name, heading in MOTIONS.items()
    )
    return Table(number, title, blocks, (SUCCESS, SPL, SMOOTH, INFERENCE), COMPARED)


def _corridor(number: str, title: str, *methods: Method, note: str = "") -> Table:
    quantities = (SUCCESS, SPL, SMOOTH)
    return Table(number, title, VERY_DENSE, quantities, (*methods, *OTHERS), note)


TABLES = (
    _open("I", "Open arena, people who see the robot", "", "reactive"),
    _open("II", "Open arena, people who do not see the robot", "_nonreactive", "nonreactive"),
    _corridor(
        "III", "Horizon H and executed steps E, very dense corridor",
        Method("Ours, H=3, E=3", "latent_planner:execute=3,horizon=3", "latent_planner H=3 E=3"),
        Method("Ours, H=3, E=1", "latent_planner:horizon=3", "latent_planner H=3 E=1", COSTLY),
        Method("Ours, H=6, E=6", OPEN_LOOP, "latent_planner H=6 E=6"),
        Method("Ours, H=6, E=1", OURS, "latent_planner H=6 E=1", COSTLY),
        Method(
            "Ours, H=10, E=10", "latent_planner:execute=10,horizon=10", "latent_planner H=10 E=10"
        ),
        Method("Ours, H=10, E=1", "latent_planner:horizon=10", "latent_planner H=10 E=1", COSTLY),
    ),
    _corridor(
        "IV", "Policy and MPPI, very dense corridor",
        Method("Policy only", "latent_planner:use_mppi=false", "policy only"),
        Method(
            "MPPI without policy prior", "latent_planner:policy_prior=false",
            "MPPI without policy prior", COSTLY,
        ),
        Method("Policy prior + MPPI", OURS, "policy prior + MPPI", COSTLY),
    ),
    _corridor(
        "V", "Smoothness penalty, very dense corridor",
        Method(
            "E=6, without smoothness", "latent_planner:execute=6,smoothness_weight=0",
            "H=6 E=6 without smoothness",
        ),
        Method(
            "E=1, without smoothness", "latent_planner:smoothness_weight=0",
            "H=6 E=1 without smoothness", COSTLY,
        ),
        Method("E=6, with smoothness", OPEN_LOOP, "H=6 E=6 with smoothness"),
        Method("E=1, with smoothness", OURS, "H=6 E=1 with smoothness", COSTLY),
        note="H=6 throughout.",
    ),
    _corridor(
        "VI", "Reward and Q in the score, very dense corridor",
        Method("SAC (Q only)", "sac", "SAC (Q only)"),
        Method("Reward only", "latent_planner:score=reward", "reward only", COSTLY),
        Method("Reward + Q", OURS, "reward + Q", COSTLY),
    ),
    Table(
        "VII", "Social reward, open arena",
        (Block("", REACTIVE, ("open", "unspecified")),),
        (SUCCESS, SPL, CUTOFF, MIN_DIST, TTC),
        (
            Method(
                "Without social reward", "latent_planner:execute=6,weights=no_social",
                "H=6 E=6 without social reward",
            ),
            Method("With social reward", OPEN_LOOP, "H=6 E=6 with social reward"),
            *OTHERS,
        ),
        note=(
            "H=6, E=6. The paper does not say which open environment this is. Here it is all four "
            "of Table I, pooled with equal weights: the choice that picks no cell."
        ),
    ),
)  # fmt: skip

STORY = ("multimodal_fast", OURS, 10)
"""Scenario, agent and number of episodes from which the snapshots of Figure 6 are chosen."""


class Cell(NamedTuple):
    """What has to be run for one agent in one scenario: seeds 0 to ``episodes`` - 1."""

    scenario: str
    agent: str
    episodes: int


def cells() -> list[Cell]:
    """Everything that the tables and figures need, each cell once, grouped by agent."""
    needed = {
        (method.agent, scenario): method.episodes
        for methods, scenarios in _demands()
        for method in methods
        for scenario in scenarios
    }
    agents = list(dict.fromkeys(agent for agent, _ in needed))
    return sorted(
        (Cell(scenario, agent, episodes) for (agent, scenario), episodes in needed.items()),
        key=lambda cell: agents.index(cell.agent),
    )


def _demands() -> Iterator[tuple[tuple[Method, ...], tuple[str, ...]]]:
    for table in TABLES:
        for block in table.blocks:
            yield table.methods, block.scenarios
    yield COMPARED, CORRIDORS
