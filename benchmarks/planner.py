"""How long does a decision take? The planner's latency beside the floor of its arithmetic.

The floor is the time of the matrix products alone that the straightforward form needs at the
paper's full budget (512 candidates, 6 iterations, H = 6): whatever else a planner does comes on
top, unless it needs fewer products or faster ones. Everything is measured in one process, in turn,
repeat by repeat, so that ratios hold on a busy machine too; printed are medians. The line "as
configured" is the planner with the settings of its weights, which plan less.

    python benchmarks/planner.py [--repeats 30] [--weights FILE] [--sac-weights FILE]

Without weights, and before any are shipped, networks with random parameters are timed: the time
does not depend on them.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from crowdbench_agents.latent_planner.agent import LatentPlanner
from crowdbench_agents.latent_planner.fused import FusedEvaluator
from crowdbench_agents.latent_planner.mppi import plan
from crowdbench_agents.latent_planner.plain import PlainEvaluator
from crowdbench_agents.latent_planner.world_model import FORMAT, WorldModel, load_world_model
from crowdbench_agents.learning.config import Config, load_config
from crowdbench_agents.learning.seeds import VALIDATION
from crowdbench_agents.learning.weights import save_weights
from crowdbench_agents.sac.agent import Sac
from crowdbench_agents.sac.networks import FORMAT as ACTOR
from crowdbench_agents.sac.networks import SacActor
from rich.console import Console
from rich.table import Table
from torch import nn

import crowdbench

BUDGET = {
    "horizon": 6, "iterations": 6, "candidates": 512, "elites": 64, "policy_share": 0.05,
    "values": "final", "constant_actions": None, "reflect": False,
}  # fmt: skip
"""The paper's."""
SCENARIO = "multimodal_fast"


class Products:
    """The matrix products of the straightforward form, nothing else, into buffers made before."""

    def __init__(self, model: WorldModel, config: Config, onednn: bool) -> None:
        self._onednn = onednn
        step = [model.dynamics, model.outcome]
        final = [model.policy_network, *model.q_networks]
        planner = config.planner
        rows, horizon, iterations = planner.candidates, planner.horizon, planner.iterations
        guided = round(planner.policy_share * rows)
        self._work = [
            *self._prepare(guided, [model.policy_network, model.dynamics], horizon),
            *self._prepare(rows, step, horizon * iterations),
            *self._prepare(rows, final, iterations),
        ]
        self.flops = sum(2 * x.shape[0] * w.numel() * times for x, w, _, times in self._work)

    def _prepare(self, rows: int, networks: Sequence[nn.Module], times: int) -> Iterator[tuple]:
        for layer in (part for network in networks for part in network.modules()):
            if isinstance(layer, nn.Linear):
                out, inside = layer.weight.shape
                weight = layer.weight.detach().clone()
                if self._onednn:
                    weight = torch.ops.mkldnn._reorder_linear_weight(weight)
                yield torch.randn(rows, inside), weight, torch.empty(rows, out), times

    def __call__(self) -> None:
        """Compute each product as often as a plan does."""
        for x, weight, out, times in self._work:
            for _ in range(times):
                if self._onednn:
                    torch.ops.mkldnn._linear_pointwise(x, weight, None, "none", [], "")
                else:
                    torch.mm(x, weight.t(), out=out)


class Driver:
    """Calls an agent on the observations of one episode, over and over."""

    def __init__(self, agent: crowdbench.Agent, seen: list[crowdbench.Observation]) -> None:
        self._agent, self._seen, self._at = agent, seen, 0
        agent.reset(crowdbench.RobotSpec.from_scenario(crowdbench.load_scenario(SCENARIO)), 0)

    def __call__(self) -> None:
        """One control step."""
        self._agent.act(self._seen[self._at % len(self._seen)])
        self._at += 1


def observations(count: int = 60) -> list[crowdbench.Observation]:
    """What a robot sees that drives towards its goal, from as many episodes as it takes."""
    env = crowdbench.parallel_env(SCENARIO)
    seen: list[crowdbench.Observation] = []
    seed = VALIDATION[0]
    while len(seen) < count:
        observed, _ = env.reset(seed=seed)
        while env.agents and len(seen) < count:
            item = crowdbench.Observation(**observed["robot_0"])
            seen.append(item)
            observed, *_ = env.step({"robot_0": np.array([0.6, np.arctan2(*item.goal[::-1])])})
        seed += 1
    return seen


def random_weights(folder: Path) -> tuple[Path, Path]:
    """Weights files of a world model and of a SAC actor with random parameters."""
    config = load_config()
    torch.manual_seed(0)
    model = WorldModel(config.model, config.perception.cells)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(0.02 * torch.randn_like(parameter))
    actor = SacActor(config.perception.cells, config.model)
    paths = folder / "model.safetensors", folder / "actor.safetensors"
    save_weights(paths[0], model.state_dict(), config, {}, FORMAT)
    save_weights(paths[1], actor.state_dict(), config, {}, ACTOR)
    return paths


def seconds(action: Callable[[], object], calls: int = 1) -> tuple[float, float]:
    """Wall time and processor time of one call."""
    wall, processor = time.perf_counter(), time.process_time()
    for _ in range(calls):
        action()
    return (time.perf_counter() - wall) / calls, (time.process_time() - processor) / calls


def measure(weights: Path, sac_weights: Path, folder: Path, repeats: int, console: Console) -> None:
    torch.set_num_threads(1)
    torch.set_grad_enabled(False)
    seen = observations()
    robot = crowdbench.RobotSpec.from_scenario(crowdbench.load_scenario(SCENARIO))

    def start() -> None:
        agent = LatentPlanner(weights=str(weights), threads=1)
        agent.reset(robot, 0)
        agent.act(seen[0])

    warm_up, _ = seconds(start)
    model, config, _ = load_world_model(weights)
    planned = config.override({f"planner.{key}": value for key, value in BUDGET.items()})
    full = folder / "full_budget.safetensors"
    save_weights(full, model.state_dict(), planned, {}, FORMAT)
    products = {kind: Products(model, planned, kind == "oneDNN") for kind in ("default", "oneDNN")}
    views = model.normalise(torch.randn(1, 1, config.model.latent))
    bounds = torch.tensor([0.5, 1.5])
    arguments = views, torch.zeros(1, 2), planned.planner, planned.loss.discount, bounds
    both = model.normalise(torch.randn(1 + config.planner.reflect, 1, config.model.latent))
    shipped = both, torch.zeros(1, 2), config.planner, config.loss.discount, bounds
    generator = torch.Generator().manual_seed(0)
    plain, fused = PlainEvaluator(model), {n: FusedEvaluator(model, n) for n in (1, 2)}

    def agent(path: Path, **options: Any) -> Driver:
        return Driver(LatentPlanner(weights=str(path), **options), seen)

    cases: dict[str, tuple[Callable[[], object], int]] = {
        "matrix products alone (the floor)": (products["default"], 1),
        "the same products through oneDNN": (products["oneDNN"], 1),
        "plan, plain form": (lambda: plan(plain, *arguments, generator), 1),
        "plan, fused form, 1 thread": (lambda: plan(fused[1], *arguments, generator), 1),
        "plan, fused form, 2 threads": (lambda: plan(fused[2], *arguments, generator), 1),
        "plan, plain form, as configured": (lambda: plan(plain, *shipped, generator), 1),
        "plan, fused form, as configured": (lambda: plan(fused[1], *shipped, generator), 1),
        "act, E = 1, 1 thread": (agent(full, threads=1), 1),
        "act, E = 1, 2 threads": (agent(full, threads=2), 1),
        "act, E = 6, per step, 1 thread": (agent(full, threads=1, execute=6), 6),
        "act, E = 6, per step, 2 threads": (agent(full, threads=2, execute=6), 6),
        "act, E = 1, 1 thread, as configured": (agent(weights, threads=1), 1),
        "act, policy only": (agent(weights, use_mppi=False), 6),
        "act, SAC": (Driver(Sac(weights=str(sac_weights)), seen), 6),
    }
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in cases}
    for repeat in range(repeats + 1):
        for name, (action, calls) in cases.items():
            taken = seconds(action, calls)
            if repeat:  # the first is for warming up
                times[name].append(taken)
    report(times, products["default"].flops, warm_up, console)


def report(
    times: dict[str, list[tuple[float, float]]], flops: float, warm_up: float, console: Console
) -> None:
    table = Table("", "wall [ms]", "x floor", "processor [ms]", "x floor")
    values = {name: np.array(each) for name, each in times.items()}
    floor = next(iter(values.values()))
    for name, each in values.items():
        wall, processor = 1e3 * np.median(each, axis=0)
        ratio, processor_ratio = np.median(each / floor, axis=0)
        table.add_row(
            name, f"{wall:.1f}", f"{ratio:.2f}", f"{processor:.1f}", f"{processor_ratio:.2f}"
        )
    console.print(table)
    console.print(
        f"{flops / 1e9:.1f} GFLOP in the straightforward form; the floor is at "
        f"{flops / np.median(floor[:, 1]) / 1e9:.0f} GFLOP per second of one core. Making the "
        f"agent, loading its weights and the first act take {warm_up:.2f} s once PyTorch is "
        f"imported. Load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores: where it is above "
        "one per core, wall times say how busy the machine is."
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=30)
    parser.add_argument("--weights", type=Path, help="of the latent planner")
    parser.add_argument("--sac-weights", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        model, actor = random_weights(Path(folder))
        weights = options.weights or model, options.sac_weights or actor
        measure(*weights, Path(folder), options.repeats, Console())


if __name__ == "__main__":
    main()
