"""What the paper's text and tables say about its method."""

from __future__ import annotations

from crowdbench_studies.paper.plan import NONREACTIVE, OPEN_LOOP, OURS, REACTIVE

from crowdbench.study import Claim

NO_LOSS = 0.05
"""What success may drop for "costs no success" still to hold."""

_CORRIDOR = ("corridor_very_dense",)
_SHORT, _LONG = "latent_planner:horizon=3", "latent_planner:horizon=10"
_NOT_SMOOTH = "latent_planner:smoothness_weight=0"
_NOT_SOCIAL = "latent_planner:execute=6,weights=no_social"


def _first(table: str, scenarios: tuple[str, ...]) -> list[Claim]:
    baselines = {"neupan": "NeuPAN", "sac": "SAC", "tdmpc": "TD-MPC-style"}
    return [
        Claim(f"Ours (E=1) above {name}", table, OURS, agent, scenarios, metric)
        for agent, name in baselines.items()
        for metric in ("success", "spl")
    ]


def _both(text: str, table: str, better: str, worse: str) -> list[Claim]:
    return [Claim(text, table, better, worse, _CORRIDOR, metric) for metric in ("success", "spl")]


def _social(text: str, metric: str, factor: float = 1.0) -> Claim:
    return Claim(text, "VII", OPEN_LOOP, _NOT_SOCIAL, REACTIVE, metric, factor)


CLAIMS = (
    *_first("I", REACTIVE),
    Claim("E=1 above E=6 in success", "I", OURS, OPEN_LOOP, REACTIVE, "success"),
    *_first("II", NONREACTIVE),
    Claim("E=1 above E=6 in success", "II", OURS, OPEN_LOOP, NONREACTIVE, "success"),
    *_both("E=1 above E=3 at H=3", "III", _SHORT, "latent_planner:execute=3,horizon=3"),
    *_both("E=1 above E=6 at H=6", "III", OURS, OPEN_LOOP),
    *_both("E=1 above E=10 at H=10", "III", _LONG, "latent_planner:execute=10,horizon=10"),
    *_both("H=6 above H=3 at E=1", "III", OURS, _SHORT),
    *_both("H=6 above H=10 at E=1", "III", OURS, _LONG),
    *_both("Prior + MPPI above the policy alone", "IV", OURS, "latent_planner:use_mppi=false"),
    *_both("Prior + MPPI above MPPI alone", "IV", OURS, "latent_planner:policy_prior=false"),
    Claim("The penalty lowers Smooth at E=1", "V", OURS, _NOT_SMOOTH, _CORRIDOR, "smoothness"),
    Claim(
        "The penalty lowers Smooth at E=6", "V", OPEN_LOOP,
        "latent_planner:execute=6,smoothness_weight=0", _CORRIDOR, "smoothness",
    ),
    Claim(
        f"The penalty costs no success at E=1 (less than {NO_LOSS:g})", "V", OURS, _NOT_SMOOTH,
        _CORRIDOR, "success", margin=-NO_LOSS,
    ),
    *_both("Reward + Q above SAC (Q only)", "VI", OURS, "sac"),
    *_both("Reward + Q above the reward alone", "VI", OURS, "latent_planner:score=reward"),
    _social("The social reward halves CutOff", "cutoff", factor=0.5),
    _social("The social reward lowers CutOff", "cutoff"),
    _social("The social reward raises MinDist", "min_dist"),
    _social("The social reward lowers TTC < 1 s", "ttc_below_1s"),
    _social("The social reward raises success", "success"),
    _social("The social reward raises SPL", "spl"),
)  # fmt: skip
