"""A longer ruler: every agent in the hard tier, with what it costs to know less.

The learned agents drive with the weights of the paper's tier; none of them has seen these worlds.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from crowdbench.scenario import scenario_names
from crowdbench.study import Block, Claim, Drawing, Method, Quantity, Study, Table
from crowdbench.study.measurements import Mean

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
    Method("informed:view=lidar", "Everything of people in view", EPISODES, bound=True),
    Method("informed:intent=sampled", "Intents unknown, walking known", EPISODES, bound=True),
    Method("informed:intent=velocity", "People walk on as they do", EPISODES, bound=True),
    Method(
        "informed:intent=velocity,view=lidar", "The same of people in view", EPISODES,
        bound=True,
    ),
    Method("straight_line", "Straight line", EPISODES, bound=True),
)  # fmt: skip
QUANTITIES = (
    Quantity("success", "Success", digits=2),
    Quantity("spl", "SPL", digits=2),
    Quantity("time_to_goal", "Time [s]", digits=1),
    Quantity("near_misses_per_min", "Near misses [1/min]", digits=2),
    Quantity("delay", "People's delay [s]", digits=3),
    Quantity("detour", "People's detour [m]", digits=3),
)
CROWDS, SITUATIONS = scenario_names("hard"), scenario_names("situation")
LADDER = ("informed", "informed:intent=sampled", "informed:intent=velocity")
"""What is foreseen, by ever less knowledge."""
FLOOR = "straight_line"


def _title(name: str) -> str:
    return name.partition("_")[2].replace("_", " ").capitalize()


def costs(measured: Measurements) -> Figure | None:
    """Success over the delay of people, a point for each agent; rungs of knowledge are hollow."""
    from matplotlib.figure import Figure

    from crowdbench.study.style import WIDTH, styles

    scenarios = (*CROWDS, *SITUATIONS)
    methods = [m for m in (*AGENTS, *RUNGS) if measured.count(m.agent, scenarios)]
    found = {
        method: measured.means(Mean(method.agent, scenarios, name) for name in ("delay", "success"))
        for method in methods
    }
    found = {method: both for method, both in found.items() if all(e.n for e in both)}
    if not found:
        return None
    looks = styles(method.agent for method in (*AGENTS, *RUNGS))
    figure = Figure(figsize=(WIDTH, 3.9), layout="constrained")
    axis = figure.subplots()
    for method, (delay, success) in found.items():
        look = looks[method.agent]
        axis.errorbar(
            delay.mean,
            success.mean,
            xerr=[[delay.mean - delay.low], [delay.high - delay.mean]],
            yerr=[[success.mean - success.low], [success.high - success.mean]],
            color=look.color,
            marker=look.marker,
            markerfacecolor="white" if method.bound else look.color,
            linestyle="",
            elinewidth=0.8,
            label=method.label,
        )
    axis.set_xlabel("Delay of people [s]")
    axis.set_ylabel("Success")
    axis.set_ylim(0, 1.02)
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2, columnspacing=0.8)
    return figure


def _claimed(text: str, better: str, worse: str) -> tuple[Claim, ...]:
    """That one agent succeeds more often than another, in each family."""
    families = (("crowds", CROWDS), ("situations", SITUATIONS))
    return tuple(
        Claim(f"{text} ({name})", "1", better, worse, tuple(scenarios), "success")
        for name, scenarios in families
    )


def _each(number: str, title: str, names: list[str]) -> Table:
    """Success and SPL, a block for each scenario."""
    blocks = tuple(Block((name,), _title(name)) for name in names)
    return Table(number, title, blocks, QUANTITIES[:2], (*AGENTS, *RUNGS))


STUDY = Study(
    name="hard",
    title="A longer ruler",
    tables=(
        Table(
            "1",
            "Both families, scenarios weighted equally",
            (Block(tuple(CROWDS), "Crowds"), Block(tuple(SITUATIONS), "Situations")),
            QUANTITIES,
            (*AGENTS, *RUNGS),
        ),
        _each("2", "Crowds, each", CROWDS),
        _each("3", "Situations, each", SITUATIONS),
    ),
    claims=(
        *_claimed("Knowing intents helps", *LADDER[:2]),
        *_claimed("Knowing how people walk and change their minds helps", *LADDER[1:]),
        *_claimed("Seeing more than a LiDAR does helps", "informed", "informed:view=lidar"),
        *(
            claim
            for first, second in pairwise(("neupan", "orca", FLOOR))
            for claim in _claimed(f"{first} gets further than {second}", first, second)
        ),
    ),
    figures=(
        Drawing(
            "figure_costs",
            "What a robot costs",
            "Success over the mean time by which people are behind where they would be without "
            "the robot, over all scenarios, with 95 % intervals. Hollow: rungs of knowledge and "
            "the straight line.",
            lambda measured, folder: costs(measured),
        ),
    ),
    introduction=(
        "Every agent among people as they walk, with a robot as one can buy: noise, dropouts, "
        "limits on acceleration, commands that act one period late. The learned agents drive with "
        "the weights that were trained for the twelve scenarios of the paper."
    ),
    reading=(
        "Below the agents stand the rungs of knowledge: the same planner, told less and less. "
        "Between two of them lies what is worth to know."
    ),
    shown=("1", "figure_costs"),
)
