"""How well does the latent rollout foresee collisions? A test of the world model in minutes.

On a fixed set of transitions (people who do not see the robot; the robot heads for its goal with
noise) two models learn whether a collision happens within H steps, given the H actions: the world
model by rolling its latent state out, and a direct predictor, the same encoder with all H actions
at once, which shows what the rollout loses. Printed: the area under the ROC curve on later time
steps than those learned from. What the encoder loses shows beside "geometry": the least distance
while everybody keeps the true present velocity, which needs no learning.

    python benchmarks/world_model.py [--updates 1200] [--set model.dynamics=plain ...]

With weights, what reinforcement learning has made of the rollout is tested on the same data, and
again after dynamics and ends have learned from these data alone, behind the encoder as it is:

    python benchmarks/world_model.py --models --weights runs/latent_planner/best.safetensors ... \\
        [--retrain 400] [--scenario all] [--driver runs/latent_planner/best.safetensors]
"""

from __future__ import annotations

import argparse
import copy
import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from crowdbench_agents.geometry.footprint import advance, point_gap
from crowdbench_agents.latent_planner.losses import encode_targets, model_loss
from crowdbench_agents.latent_planner.world_model import Mlp, WorldModel, load_world_model
from crowdbench_agents.learning.batch import Batch
from crowdbench_agents.learning.config import Config, Loss, load_config
from crowdbench_agents.learning.inputs import Inputs
from crowdbench_agents.learning.lanes import Lanes
from crowdbench_agents.learning.memory import keep_freed_memory
from crowdbench_agents.learning.noise import CorrelatedNoise
from crowdbench_agents.learning.precision import training_precision
from crowdbench_agents.learning.replay import NOBODY, Replay
from crowdbench_agents.learning.seeds import WORLD_MODEL_TEST
from crowdbench_agents.learning.worlds import as_they_are
from rich.console import Console
from scipy.stats import rankdata
from torch.nn.functional import binary_cross_entropy_with_logits

import crowdbench
from crowdbench.strict_yaml import load_yaml

SCENARIOS = ("unimodal_fast_nonreactive", "multimodal_fast_nonreactive")
FIRST_SEED, GEOMETRY_SEED = WORLD_MODEL_TEST[0], WORLD_MODEL_TEST[50_000_000]
SUBSTEPS = 4  # of a control period, in which a gap is measured
ENVIRONMENTS = 32

Drive = Callable[[Lanes], np.ndarray]
"""Actions (E, 2) in [-1, 1] of all environments."""


def wander(rng: np.random.Generator) -> Drive:
    """Towards the goals with correlated noise of standard deviation 1."""
    noise = CorrelatedNoise((ENVIRONMENTS, 2), 1.0, 0.9, rng)

    def drive(envs: Lanes) -> np.ndarray:
        off = noise.step()
        bearing = np.arctan2(envs.sensed.goal[:, 1], envs.sensed.goal[:, 0])
        command = np.stack([0.7 + 0.4 * off[:, 0], 1.5 * bearing + off[:, 1]], axis=-1)
        return np.clip(envs.bounds.normalised(command), -1, 1).astype(np.float32)

    return drive


def policy_driver(model: WorldModel, rng: np.random.Generator) -> Drive:
    """The policy with correlated noise of standard deviation 0.3."""
    noise = CorrelatedNoise((ENVIRONMENTS, 2), 0.3, 0.8, rng)

    def drive(envs: Lanes) -> np.ndarray:
        off = noise.step()
        with torch.no_grad():
            z = model.encode(Inputs(*map(torch.from_numpy, envs.sensed)))
            return np.clip(model.act(z).numpy() + off, -1, 1).astype(np.float32)

    return drive


def geometry(steps: int, config: Config) -> tuple[np.ndarray, np.ndarray]:
    """Least gaps [m] at constant velocities over the next H steps, and whether they collided."""
    drive, horizon = wander(np.random.default_rng(2)), config.planner.horizon
    envs = Lanes(
        ENVIRONMENTS, as_they_are(SCENARIOS), _episodes(GEOMETRY_SEED, SCENARIOS),
        config.perception.geometry,
    )  # fmt: skip
    everywhere = np.arange(ENVIRONMENTS)
    envs.begin(everywhere)
    scenario = envs.env.scenarios[0]
    past: list[list[tuple]] = [[] for _ in everywhere]
    gaps, labels = [], []
    for _ in range(steps):
        command = envs.bounds.physical(drive(envs))
        for i in range(ENVIRONMENTS):
            past[i].append((envs.env.state(i), command[i]))
        result = envs.step(command)
        for i in range(ENVIRONMENTS):
            collided = result.outcome[i] == "collision"
            # A collision is the label of every window that it cuts short, too.
            first = max(0, len(past[i]) - horizon)
            begins = range(first, len(past[i])) if collided else [first]
            if collided or len(past[i]) >= horizon:
                for begin in begins:
                    window = past[i][begin:]
                    gaps.append(least_gap(window[0][0], [c for _, c in window], scenario))
                    labels.append(collided)
        over = np.flatnonzero(result.over)
        for i in over.tolist():
            past[i].clear()
        envs.begin(over)
    return np.array(gaps), np.array(labels)


def least_gap(state: dict, commands: list[np.ndarray], scenario: crowdbench.Scenario) -> float:
    """Least gap [m] between the robot that drives the commands and people at constant velocity."""
    robot, people = scenario.robots, state["pedestrian_position"].copy()
    x, y, heading = state["robot_pose"][0]
    duration, least = scenario.control_period / SUBSTEPS, np.inf
    for v, w in np.repeat(commands, SUBSTEPS, axis=0):
        x, y, heading = advance(x, y, heading, v, w, duration)
        people += duration * state["pedestrian_velocity"]
        cosine, sine = np.cos(heading), np.sin(heading)
        for (px, py), around in zip(people, state["pedestrian_radius"], strict=True):
            gap = point_gap(x, y, cosine, sine, robot.length / 2, robot.width / 2, px, py)
            least = min(least, gap - around)
    return least


def collect(
    transitions: int, config: Config, names: Sequence[str], drive: Drive
) -> tuple[Replay, Replay]:
    """Drive with noise; the last tenth is for testing."""
    episodes = _episodes(FIRST_SEED, names)
    envs = Lanes(ENVIRONMENTS, as_they_are(names), episodes, config.perception.geometry)
    steps = transitions // ENVIRONMENTS
    replays = [Replay(ENVIRONMENTS, steps * 2, config.perception.cells) for _ in range(2)]
    everywhere, nobody = np.arange(ENVIRONMENTS), np.full(ENVIRONMENTS, NOBODY, np.uint8)
    envs.begin(everywhere)
    for step in range(steps):
        action, before = drive(envs), envs.sensed
        result = envs.step(envs.bounds.physical(action))
        replay = replays[step >= 0.9 * steps]
        replay.append_step(everywhere, before, action, result, action, nobody, envs.sensed)
        envs.begin(np.flatnonzero(result.over))
    return replays[0], replays[1]


def _episodes(first: int, names: Sequence[str]) -> Iterator[tuple[str, int]]:
    for number in itertools.count():
        yield names[number % len(names)], first + number


class DirectPredictor(torch.nn.Module):
    """The same encoder; all H actions at once go into a network with two hidden layers."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.world = WorldModel(config.model, config.perception.cells)
        size = config.model.latent + 2 * config.planner.horizon
        self.head = Mlp([size, 512, 512, 1], norm=True)

    def forward(self, first: Inputs, actions: torch.Tensor) -> torch.Tensor:
        """Logits (B,) of a collision; actions (H, B, 2)."""
        z = self.world.encode(first)
        return self.head(torch.cat([z, *actions], dim=-1)).squeeze(-1).float()


def first_of(batch: Batch) -> Inputs:
    return Inputs(*(x[0] for x in batch.inputs))


def collides(batch: Batch) -> torch.Tensor:
    return (batch.collision * batch.valid).amax(dim=0)


@torch.no_grad()
def rollout_score(model: WorldModel, batch: Batch) -> torch.Tensor:
    """Log-odds-like score (B,) of a collision within the rollout: -log P(no collision)."""
    z, score = model.encode(first_of(batch)), torch.zeros(batch.action.shape[1])
    for action in batch.action:
        _, end = model.reward_and_end(z, action)
        score = score + torch.nn.functional.softplus(end.float())
        z = model.next(z, action)
    return score


def auc(score: np.ndarray, label: np.ndarray) -> float:
    """Area under the ROC curve by the rank-sum formula."""
    ranks, positive = rankdata(score), label > 0.5
    count, others = positive.sum(), (~positive).sum()
    return float((ranks[positive].sum() - count * (count + 1) / 2) / (count * others))


def rollout_auc(model: WorldModel, tests: list[Batch]) -> float:
    """AUC of a trained rollout, to which an arrival is an end as well: windows with one are out."""
    score = torch.cat([rollout_score(model, batch) for batch in tests])
    label = torch.cat([collides(batch) for batch in tests])
    ended = torch.cat([(batch.end * batch.valid).amax(dim=0) for batch in tests])
    kept = label == ended
    return auc(score[kept].numpy(), label[kept].numpy())


def draw(train: Replay, config: Config, size: int, rng: np.random.Generator) -> Batch:
    """Sequences as in training, of which only collisions count as ends."""
    settings = config.training
    batch = train.sample(
        size, config.planner.horizon, rng, settings.collision_share, settings.reflect
    )
    return batch._replace(end=batch.collision, reward=batch.reward * settings.reward_scale)


def retrain(model: WorldModel, train: Replay, config: Config, updates: int, size: int) -> None:
    """Let dynamics and ends learn nothing but collisions, behind the encoder as it is."""
    others = ("reward", "value", "consistency", "imitation_shaping")
    ends = config.override({f"loss.{name}": 0.0 for name in others}).loss
    parameters = [*model.dynamics.parameters(), *model.outcome.parameters()]
    for parameter in parameters:
        parameter.requires_grad_(True)
    optimizer = torch.optim.Adam(parameters, config.training.learning_rate_model)
    rng = np.random.default_rng(1)
    for _ in range(updates):
        batch = draw(train, config, size, rng)
        loss = whole_loss(model, model, batch, ends, torch.zeros_like(batch.action))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()


def whole_loss(
    model: WorldModel, target: WorldModel, batch: Batch, loss: Loss, noise: torch.Tensor
) -> torch.Tensor:
    """The world model's loss, encoding included."""
    z = model.encode(Inputs(*(x[0] for x in batch.inputs)))
    return model_loss(model, z, encode_targets(target, batch, loss, noise), batch, loss).total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--transitions", type=int, default=96_000)
    parser.add_argument("--updates", type=int, default=1200)
    parser.add_argument("--report", type=int, default=400)
    parser.add_argument("--batch", type=int, default=128)
    kinds = ["geometry", "rollout", "direct"]
    parser.add_argument("--models", nargs="*", default=kinds, choices=kinds)
    parser.add_argument("--weights", nargs="*", default=[], type=Path)
    parser.add_argument("--driver", type=Path, help="weights of a policy that drives instead")
    parser.add_argument("--retrain", type=int, default=0, help="updates of each of the weights")
    parser.add_argument(
        "--scenario", action="append", help="all, or some; by default fast, nonreactive ones"
    )
    parser.add_argument("--set", nargs="*", default=[], help="section.field=value")
    arguments = parser.parse_args()
    if arguments.retrain and not arguments.weights:
        parser.error("--retrain needs --weights")
    keep_freed_memory()
    torch.set_num_threads(1)
    changes = {item.split("=")[0]: load_yaml(item.split("=")[1]) for item in arguments.set}
    config = load_config().override(changes)
    console = Console()
    learned = [name for name in arguments.models if name != "geometry"]
    if "geometry" in arguments.models:
        gaps, labels = geometry(arguments.transitions // 10 // ENVIRONMENTS, config)
        console.print(f"geometry  AUC {auc(-gaps, labels):.3f}, {len(gaps)} windows")
    if not learned and not arguments.weights:
        return
    began = time.perf_counter()
    names = arguments.scenario or SCENARIOS
    if names == ["all"]:
        names = crowdbench.scenario_names("paper")
    driver = arguments.driver
    rng = np.random.default_rng(0)
    drive = policy_driver(load_world_model(driver)[0], rng) if driver else wander(rng)
    train, test = collect(arguments.transitions, config, names, drive)
    horizon = config.planner.horizon
    tests = [test.sample(500, horizon, np.random.default_rng(i)) for i in range(12)]
    share = np.mean([collides(batch).mean().item() for batch in tests])
    console.print(
        f"{len(train)} rows in {time.perf_counter() - began:.0f} s, collisions {share:.3f}"
    )
    for path in arguments.weights:
        model, trained, _ = load_world_model(path)
        if trained.perception != config.perception or trained.planner.horizon != horizon:
            parser.error(f"{path}: its obstacle map or horizon is not that of the test data")
        areas = [rollout_auc(model, tests)]
        if arguments.retrain:
            retrain(model, train, config, arguments.retrain, arguments.batch)
            areas.append(rollout_auc(model, tests))
        console.print(f"{path}  AUC {' -> '.join(f'{x:.3f}' for x in areas)}", soft_wrap=True)
    for name in learned:
        learn(name, config, train, tests, arguments, console)


def learn(
    name: str,
    config: Config,
    train: Replay,
    tests: list[Batch],
    arguments: argparse.Namespace,
    console: Console,
) -> None:
    torch.manual_seed(0)
    rng = np.random.default_rng(1)
    bf16 = training_precision(config.training.bfloat16)
    world = WorldModel(config.model, config.perception.cells)
    model, target = world if name == "rollout" else DirectPredictor(config), copy.deepcopy(world)
    optimizer = torch.optim.Adam(
        model.parameters(), config.training.learning_rate_model, fused=True
    )
    began = time.perf_counter()
    for update in range(1, arguments.updates + 1):
        batch = draw(train, config, arguments.batch, rng)
        with bf16:
            if isinstance(model, WorldModel):
                noise = torch.randn_like(batch.action)
                loss = whole_loss(model, target, batch, config.loss, noise)
            else:
                logit = model(first_of(batch), batch.action)
                loss = binary_cross_entropy_with_logits(logit, collides(batch))
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), config.training.gradient_clip)
        optimizer.step()
        if name == "rollout":
            with torch.no_grad():
                for slow, fast in zip(target.parameters(), model.parameters(), strict=True):
                    slow.lerp_(fast, config.training.target_rate)
        if update % arguments.report == 0:
            seconds = time.perf_counter() - began
            with bf16, torch.no_grad():
                scores = [
                    rollout_score(model, b)
                    if isinstance(model, WorldModel)
                    else model(first_of(b), b.action)
                    for b in tests
                ]
            label = torch.cat([collides(b) for b in tests]).numpy()
            area = auc(torch.cat(scores).float().numpy(), label)
            console.print(f"{name:8} update {update:5}  AUC {area:.3f}  {seconds:.0f} s")


if __name__ == "__main__":
    main()
