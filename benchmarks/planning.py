"""Which settings of the planner drive best? Validation of many robots at once.

Every form is the settings of the weights with some of them replaced, or "policy", which drives
without planning. Plans are made by the plain form of the planner for all robots together and
under bfloat16, so figures are those of `crowdbench run` up to rounding and random draws.

    python benchmarks/planning.py runs/latent_planner/best.safetensors policy \\
        temperature=0.1,constant_actions=[5,9] start=previous,max_std=1,execute=6
"""

from __future__ import annotations

import argparse
import re
import time
from pathlib import Path

import numpy as np
import torch
from crowdbench_agents.latent_planner.learner import policy_act
from crowdbench_agents.latent_planner.mppi import encode_views, plan
from crowdbench_agents.latent_planner.plain import PlainEvaluator
from crowdbench_agents.latent_planner.plan_queue import PlanQueue
from crowdbench_agents.latent_planner.scoring import Score
from crowdbench_agents.latent_planner.world_model import WorldModel, load_world_model
from crowdbench_agents.learning.config import Config
from crowdbench_agents.learning.inputs import ActionBounds, Inputs
from crowdbench_agents.learning.memory import keep_freed_memory
from crowdbench_agents.learning.precision import training_precision
from crowdbench_agents.learning.seeds import VALIDATION
from crowdbench_agents.learning.validation import (
    ENVIRONMENTS,
    Act,
    PolicyInput,
    validate,
)
from crowdbench_agents.learning.worlds import as_they_are
from numpy.typing import NDArray
from pydantic import TypeAdapter
from rich.console import Console

import crowdbench
from crowdbench.strict_yaml import load_yaml

HARD = (
    "multimodal_fast", "unimodal_fast_nonreactive", "multimodal_fast_nonreactive",
    "corridor_very_dense",
)  # fmt: skip


def planner_act(model: WorldModel, config: Config, execute: int, score: Score) -> Act:
    """Act by MPPI: a plan every ``execute`` steps, from the previous one moved on."""
    planner = config.planner
    generator = torch.Generator().manual_seed(0)
    robot = crowdbench.RobotSpec.from_scenario(crowdbench.load_scenario(HARD[0]))
    half = torch.from_numpy(ActionBounds.of(robot).half)
    evaluator, queue = PlainEvaluator(model), PlanQueue(ENVIRONMENTS, planner.horizon)

    @torch.no_grad()
    def act(given: PolicyInput) -> NDArray[np.float32]:
        due = np.flatnonzero(given.steps % execute == 0)
        if len(due):
            inputs = Inputs(*(torch.from_numpy(x[due]) for x in given.sensed))
            views = encode_views(model, model.encode(inputs), inputs, planner)
            place = given.place[due]
            queue.clear(place[given.steps[due] == 0])
            with training_precision(bfloat16=True):
                made = plan(
                    evaluator, views, torch.from_numpy(given.velocity[due]), planner,
                    config.loss.discount, half, generator, queue.rest(place), score,
                )  # fmt: skip
            queue.put(place, made.actions)
        return queue.take(given.place).numpy()

    return act


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("weights", type=Path)
    parser.add_argument("form", nargs="+", help="policy, or setting=value,... of the planner")
    parser.add_argument("--episodes", type=int, default=20, help="per scenario")
    parser.add_argument("--first-seed", type=int, default=VALIDATION[0])
    parser.add_argument("--scenario", action="append", help="the hardest four by default; or all")
    arguments = parser.parse_args()
    keep_freed_memory()
    torch.set_num_threads(1)
    model, config, _ = load_world_model(arguments.weights)
    names = arguments.scenario or HARD
    if names == ["all"]:
        names = crowdbench.scenario_names("paper")
    worlds = as_they_are(names)
    console = Console()
    console.print(f"columns: {' '.join(names)}; {arguments.episodes} episodes each")
    for form in arguments.form:
        begun = time.perf_counter()
        if form == "policy":
            act = policy_act(model)
        else:
            parts = re.split(r",(?![^[]*\])", form)  # at commas outside of brackets
            values = dict(part.split("=", 1) for part in parts if part)
            execute = int(values.pop("execute", 1))
            score = TypeAdapter(Score).validate_python(values.pop("score", "reward_q"))
            changed = {f"planner.{key}": load_yaml(x) for key, x in values.items()}
            act = planner_act(model, config.override(changed), execute, score)
        result = validate(
            act, config.perception.geometry, arguments.episodes, worlds, arguments.first_seed
        )
        each = " ".join(f"{x:.2f}" for x in result.success.values())
        console.print(
            f"{form}: {result.mean:.3f} ({each}), SPL {result.mean_spl:.3f}, "
            f"smoothness {result.smoothness:.3f}, {result.seconds:.1f} s "
            f"to the goal [{time.perf_counter() - begun:.0f} s]",
            soft_wrap=True, highlight=False,
        )  # fmt: skip


if __name__ == "__main__":
    main()
