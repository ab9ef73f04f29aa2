"""A longer ruler: every agent in the hard tier, with what it costs to know less.

The learned agents drive with the weights of the paper's tier; none of them has seen these worlds.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from crowdbench.scenario import scenario_names
from crowdbench.study import Block, Claim, Drawing, Method, Quantity, Study, Table
from crowdbench.study.measurements import Mean, Pair
from crowdbench.study.tables import SIGNIFICANCE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from crowdbench.evaluation.statistics import Difference, Estimate
    from crowdbench.study.measurements import Measurements

EPISODES = 100

AGENTS = (
    Method("neupan", "NeuPAN", EPISODES),
    Method("orca", "ORCA", EPISODES),
    Method("dynamic_window", "Dynamic window", EPISODES),
    Method("sac", "SAC", EPISODES),
    Method("tdmpc", "TD-MPC-style", EPISODES),
    Method("latent_planner", "Latent planner", EPISODES),
)
RUNGS = (
    Method("informed", "Everything known", EPISODES, bound=True),
    Method("informed:view=lidar", "Everything, of people in view", EPISODES, bound=True),
    Method("informed:intent=sampled", "Intents unknown, walking known", EPISODES, bound=True),
    Method("informed:intent=velocity", "People walk on as they do", EPISODES, bound=True),
    Method("informed:intent=velocity,view=lidar", "The same, in view", EPISODES, bound=True),
    Method("straight_line", "Straight line", EPISODES, bound=True),
)  # fmt: skip
QUANTITIES = (
    Quantity("success", "Success", digits=2),
    Quantity("spl", "SPL", digits=2),
    Quantity("time_to_goal", "Time [s]", digits=1),
    Quantity("near_misses_per_min", "Near misses [1/min]", digits=2),
    Quantity("robot_at_fault", "At fault in collisions", digits=2),
)
DISTURBANCES = tuple(
    Quantity(f"{name}{ending}", f"{name.capitalize()}{words} [{unit}]", digits=digits)
    for name, unit, digits in (("delay", "s", 3), ("detour", "m", 3), ("displacement", "m", 2))
    for ending, words in (("", ""), ("_by_chance", " by chance"))
)
CROWDS, SITUATIONS = scenario_names("hard"), scenario_names("situation")
LADDER = ("informed", "informed:intent=sampled", "informed:intent=velocity")
"""What is foreseen, by ever less knowledge."""
FLOOR = RUNGS[-1]
APART = 0.05
"""A difference in success or SPL that counts, at ``SIGNIFICANCE`` in a paired test."""


def _title(name: str) -> str:
    return name.partition("_")[2].replace("_", " ").capitalize()


def _ran(measured: Measurements, method: Method, scenario: str) -> bool:
    """Whether all its episodes in a scenario are stored."""
    return measured.count(method.agent, (scenario,)) == method.episodes


def costs(measured: Measurements) -> Figure | None:
    """Success over what people lose, a point for each agent; rungs of knowledge are hollow."""
    from matplotlib.figure import Figure

    from crowdbench.study.style import WIDTH, Style, styles

    scenarios = (*CROWDS, *SITUATIONS)
    ran = [
        method
        for method in (*AGENTS, *RUNGS)
        if all(_ran(measured, method, name) for name in scenarios)
    ]
    if not ran:
        return None
    looks = styles(method.agent for method in AGENTS)
    markers = ("d", "p", "<", ">", "h", "o")
    looks |= {
        rung.agent: Style("0.3", marker, "-") for rung, marker in zip(RUNGS, markers, strict=True)
    }

    def means(name: str) -> list[Estimate]:
        return measured.means(Mean(method.agent, scenarios, name) for method in ran)

    figure = Figure(figsize=(WIDTH, 3.9), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    reached = means("success")
    for axis, name, label in zip(
        axes, ("delay", "displacement"), ("Delay of people [s]", "Displacement [m]"), strict=True
    ):
        # Where people enter depends on the robot, so chance is not quite the same beside all.
        chances = means(f"{name}_by_chance")
        low, high = min(x.low for x in chances), max(x.high for x in chances)
        axis.axvspan(low, high, color="0.9", zorder=0, label="By chance")
        for method, lost, success in zip(ran, means(name), reached, strict=True):
            look = looks[method.agent]
            axis.errorbar(
                lost.mean,
                success.mean,
                xerr=[[lost.mean - lost.low], [lost.high - lost.mean]],
                yerr=[[success.mean - success.low], [success.high - success.mean]],
                color=look.color,
                marker=look.marker,
                markerfacecolor="white" if method.bound else look.color,
                linestyle="",
                elinewidth=0.8,
                label=method.label,
            )
        axis.set_xlabel(label)
    axes[0].set_ylabel("Success")
    axes[0].set_ylim(0, 1.02)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2, columnspacing=0.8)
    return figure


class Lead(NamedTuple):
    """By how much the best agent of those without privileges is ahead of the next."""

    best: Method
    second: Method
    difference: Difference

    @property
    def apart(self) -> bool:
        """Whether the two can be told apart; not corrected for how often that is asked."""
        return self.difference.mean > APART and self.difference.p < SIGNIFICANCE


def leads(measured: Measurements, metric: str) -> dict[str, Lead]:
    """Who leads in each scenario that two agents have run in full, and by how much.

    Args:
        measured: the stored episodes.
        metric: of which more is better.
    """
    found: dict[str, tuple[Method, Method]] = {}
    for name in (*CROWDS, *SITUATIONS):
        there = [method for method in AGENTS if _ran(measured, method, name)]
        means = measured.means(Mean(method.agent, (name,), metric) for method in there)
        ranked = sorted(zip(there, means, strict=True), key=lambda pair: -pair[1].mean)
        if len(ranked) > 1:
            found[name] = ranked[0][0], ranked[1][0]
    differences = measured.differences(
        Pair((best.agent, (name,)), (second.agent, (name,)), metric)
        for name, (best, second) in found.items()
    )
    return {
        name: Lead(*both, difference)
        for (name, both), difference in zip(found.items(), differences, strict=True)
    }


def _beside(method: Method) -> float:
    """By how much of a row an agent's mark is below its middle: equal means stay apart."""
    return 0.1 * (AGENTS.index(method) - (len(AGENTS) - 1) / 2)


def spread(measured: Measurements) -> Figure | None:
    """Success and SPL of every agent in every scenario; a line where the best two lie apart."""
    from matplotlib.figure import Figure

    from crowdbench.study.style import WIDTH, styles

    scenarios = (*CROWDS, *SITUATIONS)
    looks = styles(method.agent for method in AGENTS)
    led = {quantity.metric: leads(measured, quantity.metric) for quantity in QUANTITIES[:2]}
    asked = set.intersection(*map(set, led.values()))
    if not asked:
        return None
    figure = Figure(figsize=(2 * WIDTH, 4.4), layout="constrained")
    for axis, quantity in zip(figure.subplots(1, 2, sharey=True), QUANTITIES[:2], strict=True):
        metric = quantity.metric
        for method in AGENTS:
            here = [name for name in scenarios if _ran(measured, method, name)]
            if not here:
                continue
            lower = _beside(method)
            means = measured.means(Mean(method.agent, (name,), metric) for name in here)
            look = looks[method.agent]
            axis.plot(
                [mean.mean for mean in means],
                [scenarios.index(name) + lower for name in here],
                color=look.color,
                marker=look.marker,
                linestyle="",
                label=method.label,
            )
        for name, lead in led[metric].items():
            if lead.apart:
                best = (lead.best, lead.second)
                ends = measured.means(Mean(method.agent, (name,), metric) for method in best)
                rows = [scenarios.index(name) + _beside(method) for method in best]
                axis.plot([end.mean for end in ends], rows, color="0.3", zorder=1)
        axis.set_xlabel(quantity.heading)
        axis.set_xlim(-0.02, 1.02)
        axis.set_yticks(range(len(scenarios)), [_title(name) for name in scenarios])
    axis.set_ylim(len(scenarios) - 0.5, -0.5)
    count = sum(any(led[metric][name].apart for metric in led) for name in asked)
    figure.suptitle(
        f"The best two differ by more than {APART:g} (p < {SIGNIFICANCE:g}) in success or SPL in "
        f"{count} of {len(asked)} scenarios",
        fontsize=8,
    )
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(AGENTS))
    return figure


def _claimed(text: str, better: str, worse: str) -> tuple[Claim, ...]:
    """That one agent succeeds more often than another, in each family."""
    families = (("crowds", CROWDS), ("situations", SITUATIONS))
    return tuple(
        Claim(f"{text} ({name})", "1", better, worse, tuple(scenarios), "success")
        for name, scenarios in families
    )


def _both(number: str, title: str, quantities: tuple[Quantity, ...], note: str) -> Table:
    """Some quantities, a block for each family."""
    blocks = (Block(tuple(CROWDS), "Crowds"), Block(tuple(SITUATIONS), "Situations"))
    return Table(number, title, blocks, quantities, (*AGENTS, *RUNGS), note)


def _each(number: str, title: str, names: list[str]) -> Table:
    """Success and SPL, a block for each scenario."""
    blocks = tuple(Block((name,), _title(name)) for name in names)
    return Table(number, title, blocks, QUANTITIES[:2], (*AGENTS, *RUNGS))


STUDY = Study(
    name="hard",
    title="A longer ruler",
    tables=(
        _both(
            "1",
            "Both families, the episodes of all their scenarios",
            QUANTITIES,
            "Time: of the episodes in which an agent arrives, which are the easier ones where it "
            "seldom does. At fault: the share of its collisions in which the robot drove into what "
            "it touched.",
        ),
        _both(
            "2",
            "What the robot costs people",
            DISTURBANCES,
            "By chance: the same of people without the robot whom a push of 1 mm has disturbed. "
            "Who fails early is in people's way for less long.",
        ),
        _each("3", "Crowds, each", CROWDS),
        _each("4", "Situations, each", SITUATIONS),
    ),
    claims=(
        *_claimed("Knowing intents helps", *LADDER[:2]),
        *_claimed("Knowing how people walk and change their minds helps", *LADDER[1:]),
        *_claimed("Seeing more than a LiDAR does helps", "informed", "informed:view=lidar"),
        *(
            claim
            for first, second in pairwise((AGENTS[0], AGENTS[1], FLOOR))
            for claim in _claimed(
                f"{first.label} succeeds more often than {second.label}", first.agent, second.agent
            )
        ),
    ),
    figures=(
        Drawing(
            "figure_costs",
            "What a robot costs",
            "Success over the mean time by which the robot has set people back on their ways "
            "(below 0: brought forward), and over the largest mean distance by which it has "
            "shifted them, over all scenarios, with 95 % intervals; grey: the same "
            "of people whom a push of 1 mm has disturbed, and no robot. Hollow: rungs of knowledge "
            "and the straight line. Agents that have not run everywhere in full are not shown.",
            lambda measured, folder: costs(measured),
        ),
        Drawing(
            "figure_spread",
            "Who gets how far where",
            "Means of the agents without privileges in each scenario that they have run in full. "
            "A line joins the best two "
            f"where they differ by more than {APART:g} (p < {SIGNIFICANCE:g} in a paired test, "
            "not corrected for the number of scenarios).",
            lambda measured, folder: spread(measured),
        ),
    ),
    introduction=(
        "Every agent among people as they walk, with a robot as one can buy: noise, dropouts, "
        "limits on acceleration, commands that act one period late. `neupan`, `orca` and "
        "`dynamic_window` were tuned for such a robot in these scenarios, on other seeds. "
        "`sac`, `tdmpc` and `latent_planner` drive with the weights of the paper's twelve "
        "scenarios, whose robot has no such limits. The metrics are defined in docs/metrics.md, "
        "the scenarios described in docs/scenarios.md."
    ),
    reading=(
        "Below the agents stand, as bounds, the rungs of knowledge: one planner, `informed`, that "
        "knows exactly where people are and how fast, of everybody or of those in view of a LiDAR "
        "at the robot's place. It also knows all that they will do, or how they walk and change "
        "their minds but not their goals (`intent=sampled`), or takes them to walk on as they do "
        "(`intent=velocity`): docs/informed.md. So there are two ladders, of sight and of "
        "foresight. `straight_line` ignores people."
    ),
    shown=("1", "2", "figure_costs", "figure_spread"),
)
