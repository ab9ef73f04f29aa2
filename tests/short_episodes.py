"""Episodes as short as can be, of one cell, and a scenario of such."""

from crowdbench import load_scenario
from crowdbench.evaluation.results import Cell, Result
from crowdbench.simulation import WORLD_VERSION

CELL = Cell(
    scenario="by_hand",
    scenario_digest="0123456789ab",
    agent="planner:gain=2",
    options='{"gain": 2}',
    world=WORLD_VERSION,
    weights_sha256="",
    code="a file",
)

TINY = load_scenario(
    "multimodal_fast",
    name="tiny",
    time_limit=1.2,
    arena={"length": 6, "width": 6},
    robots={"travel": 4},
    pedestrians={"count": 2, "leg": 2},
)


def row(seed, robot="robot_0", **values):
    """An episode as short as one can be."""
    facts = {"outcome": "success", "steps": 3, "metrics": {"success": 1.0}}
    return Result(seed, robot, **{**facts, **values})
