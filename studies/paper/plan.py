"""The paper's tables: its methods, scenarios and quantities."""

from __future__ import annotations

from crowdbench_studies.paper.reference import with_reference

from crowdbench.study import Block, Cell, Method, Quantity, Table

CHEAP, COSTLY = 500, 100
"""Episodes per cell, on seeds 0, 1, ...: planners that plan anew at every step get fewer."""

MOTIONS = {
    "unimodal_slow": "Uni-modal, slow",
    "unimodal_fast": "Uni-modal, fast",
    "multimodal_slow": "Multi-modal, slow",
    "multimodal_fast": "Multi-modal, fast",
}
CORRIDORS = ("corridor_sparse", "corridor_moderate", "corridor_dense", "corridor_very_dense")

SUCCESS = Quantity("success", "Success", digits=2)
SPL = Quantity("spl", "SPL", digits=2)
SMOOTH = Quantity("smoothness", "Smooth", digits=2)
INFERENCE = Quantity(  # the paper's times are a GPU's
    "inference_s", "Inference [ms]", rounding=0.0005, judged=False
)
CUTOFF = Quantity("cutoff", "CutOff [1/ep.]")
MIN_DIST = Quantity("min_dist", "MinDist [m]", digits=2)
TTC = Quantity("ttc_below_1s", "TTC < 1 s [%]", rounding=0.0005)

OURS = "latent_planner"
OPEN_LOOP = "latent_planner:execute=6"
OTHERS = (
    Method("orca", "ORCA", CHEAP),
    Method("dynamic_window", "Dynamic window", CHEAP),
    Method("straight_line", "Straight line (floor)", CHEAP, bound=True),
    Method("informed", "Informed (ceiling)", CHEAP, bound=True),
)
COMPARED = (
    Method("neupan", "NeuPAN", CHEAP),
    Method("sac", "SAC", CHEAP),
    Method("tdmpc", "TD-MPC-style", COSTLY),
    Method(OPEN_LOOP, "Ours, H=6, E=6", CHEAP),
    Method(OURS, "Ours, H=6, E=1", COSTLY),
    *OTHERS,
)
VERY_DENSE = (Block(("corridor_very_dense",)),)
REACTIVE = tuple(MOTIONS)
NONREACTIVE = tuple(f"{name}_nonreactive" for name in MOTIONS)


def _open(number: str, title: str, suffix: str) -> Table:
    blocks = tuple(Block((name + suffix,), heading) for name, heading in MOTIONS.items())
    quantities = (SUCCESS, SPL, SMOOTH, INFERENCE)
    return with_reference(Table(number, title, blocks, quantities, COMPARED))


def _corridor(number: str, title: str, *methods: Method, note: str = "") -> Table:
    quantities = (SUCCESS, SPL, SMOOTH)
    return with_reference(Table(number, title, VERY_DENSE, quantities, (*methods, *OTHERS), note))


TABLES = (
    _open("I", "Open arena, reactive pedestrians", ""),
    _open("II", "Open arena, non-reactive pedestrians", "_nonreactive"),
    _corridor(
        "III",
        "Horizon H and executed steps E, very dense corridor",
        Method("latent_planner:execute=3,horizon=3", "Ours, H=3, E=3", CHEAP),
        Method("latent_planner:horizon=3", "Ours, H=3, E=1", COSTLY),
        Method(OPEN_LOOP, "Ours, H=6, E=6", CHEAP),
        Method(OURS, "Ours, H=6, E=1", COSTLY),
        Method("latent_planner:execute=10,horizon=10", "Ours, H=10, E=10", CHEAP),
        Method("latent_planner:horizon=10", "Ours, H=10, E=1", COSTLY),
    ),
    _corridor(
        "IV",
        "Policy and MPPI, very dense corridor",
        Method("latent_planner:use_mppi=false", "Policy only", CHEAP),
        Method("latent_planner:policy_prior=false", "MPPI without policy prior", COSTLY),
        Method(OURS, "Policy prior + MPPI", COSTLY),
    ),
    _corridor(
        "V",
        "Smoothness penalty, very dense corridor",
        Method("latent_planner:execute=6,smoothness_weight=0", "E=6, without smoothness", CHEAP),
        Method("latent_planner:smoothness_weight=0", "E=1, without smoothness", COSTLY),
        Method(OPEN_LOOP, "E=6, with smoothness", CHEAP),
        Method(OURS, "E=1, with smoothness", COSTLY),
        note="H=6 throughout.",
    ),
    _corridor(
        "VI",
        "Reward and Q in the score, very dense corridor",
        Method("sac", "SAC (Q only)", CHEAP),
        Method("latent_planner:score=reward", "Reward only", COSTLY),
        Method(OURS, "Reward + Q", COSTLY),
    ),
    with_reference(
        Table(
            "VII",
            "Social reward, open arena",
            (Block(REACTIVE),),
            (SUCCESS, SPL, CUTOFF, MIN_DIST, TTC),
            (
                Method(
                    "latent_planner:execute=6,weights=no_social", "Without social reward", CHEAP
                ),
                Method(OPEN_LOOP, "With social reward", CHEAP),
                *OTHERS,
            ),
            note=(
                "H=6, E=6. The paper does not say which open environment this is. Here it is all "
                "four of Table I, pooled with equal weights: the choice that picks no cell."
            ),
        )
    ),
)

STORY = Cell("multimodal_fast", OURS, 10)
"""The episodes from which the snapshots of Figure 6 are chosen."""

MORE = tuple(
    Cell(scenario, method.agent, method.episodes) for method in COMPARED for scenario in CORRIDORS
)
"""What Figure 4 needs beyond the tables."""
