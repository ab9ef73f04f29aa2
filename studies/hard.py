"""A longer ruler: every agent in the hard tier, with what it costs to know less.

The learned agents drive with the weights of the paper's tier; none of them has seen these worlds.
"""

from __future__ import annotations

from crowdbench.scenario import scenario_names
from crowdbench.study import Block, Method, Quantity, Study, Table

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
)
CROWDS, SITUATIONS = scenario_names("hard"), scenario_names("situation")


def _title(name: str) -> str:
    return name.partition("_")[2].replace("_", " ").capitalize()


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
    introduction=(
        "Every agent among people as they walk, with a robot as one can buy: noise, dropouts, "
        "limits on acceleration, commands that act one period late. The learned agents drive with "
        "the weights that were trained for the twelve scenarios of the paper."
    ),
    reading=(
        "Below the agents stand the rungs of knowledge: the same planner, told less and less. "
        "Between two of them lies what is worth to know."
    ),
    shown=("1",),
)
