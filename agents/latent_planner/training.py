"""Training of the latent planner and of its TD-MPC-style relative.

Many environments run in one process. Each round every environment takes one step, the step goes
into the replay, and the networks are updated. Demonstrations come first and stay in each batch.
"""

from __future__ import annotations

import fcntl
import json
import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from crowdbench_agents.latent_planner.config import Config, load_config
from crowdbench_agents.latent_planner.crowds import Crowds, worlds_digest
from crowdbench_agents.latent_planner.demonstrations import (
    Teachers,
    final_rows,
    open_replays,
)
from crowdbench_agents.latent_planner.exploration import Explorer
from crowdbench_agents.latent_planner.learner import Learner, TrainingError
from crowdbench_agents.latent_planner.memory import keep_freed_memory
from crowdbench_agents.latent_planner.progress import Journal, stop_on_signals
from crowdbench_agents.latent_planner.replay import TEACHER, Batch, Rows, join
from crowdbench_agents.latent_planner.validation import policy_act, validate
from crowdbench_agents.latent_planner.weights import FORMAT, save_weights

import crowdbench

RUNS, CURVES = Path("runs"), Path("results/training")
EASY_WEIGHT = 0.1
"""Weight in the mixture of a scenario that always succeeds; one that never does has 1 more."""
SUCCESS_RATE = 0.02  # of the running success while training, per episode
SEEDS_PER_RUN = 50_000_000


class Mixture:
    """Draws the scenario and seed of each training episode, the harder scenarios more often."""

    def __init__(self, seed: int) -> None:
        self.success = dict.fromkeys(crowdbench.scenario_names(), 0.5)
        self.episodes = 0
        # Far from the demonstrations' seeds, which every run shares.
        self._first = 10_000_000 + seed * SEEDS_PER_RUN
        self._rng = np.random.default_rng([seed, 1])

    def __iter__(self) -> Iterator[tuple[str, int]]:
        return self

    def __next__(self) -> tuple[str, int]:
        weights = EASY_WEIGHT + 1 - np.array(list(self.success.values()))
        name = self._rng.choice(list(self.success), p=weights / weights.sum())
        self.episodes += 1
        return str(name), self._first + self.episodes

    def record(self, name: str, success: bool) -> None:
        """Follow the success in a scenario."""
        self.success[name] += SUCCESS_RATE * (success - self.success[name])


class Run:
    """One training run and all that has to survive an interruption."""

    def __init__(self, folder: Path, config: Config, seed: int, social: bool) -> None:
        self.folder, self.config = folder, config
        self.learner = Learner(config, seed)
        self.mixture = Mixture(seed)
        settings = config.training
        count = settings.environments
        self.crowds = Crowds(count, self.mixture, config.perception.geometry)
        self.explorer = Explorer(self.learner.model, config, self.crowds.bounds, seed)
        self.rng = np.random.default_rng([seed, 2])
        self.replay, self.demonstrations = open_replays(folder, config, self.crowds, social)
        # MPPI acts in the first environments, the teacher advises in the last.
        taught = np.arange(count - settings.taught_environments, count)
        self.teachers = Teachers(settings.teacher, self.crowds, taught)
        self.steps, self.seconds, self.best = 0, 0.0, -1.0

    def begin(self) -> None:
        """Start an episode in every environment."""
        self.replay.cut()
        self._begin(np.arange(self.crowds.count))

    def step(self) -> None:
        """One control step in every environment."""
        crowds, everywhere = self.crowds, np.arange(self.crowds.count)
        with self.learner.precision():
            acts = self.explorer.act(crowds.sensed)
        acts.reference[self.teachers.which] = self.teachers.advise()
        acts.source[self.teachers.which] = TEACHER
        before = tuple(x.copy() for x in crowds.sensed)
        result = crowds.step(everywhere, crowds.bounds.physical(acts.action))
        collided = result.outcome == "collision"
        no = np.zeros(len(everywhere), bool)
        self.replay.append(
            everywhere,
            Rows(
                *before, acts.action, result.reward, result.social, result.end, collided, no,
                acts.reference, acts.source,
            ),
        )  # fmt: skip
        self.steps += len(everywhere)
        over = np.flatnonzero(result.over)
        if len(over):
            self.replay.append(over, final_rows(*(x[over] for x in crowds.sensed)))
            for index in over:
                success = result.outcome[index] == "success"
                self.mixture.record(crowds.scenario[index], success)
            self._begin(over)

    def update(self) -> dict[str, torch.Tensor]:
        """One update from the replay and the demonstrations."""
        return self.learner.update(self._batch())

    def _begin(self, which: np.ndarray) -> None:
        self.crowds.begin(which)
        self.teachers.begin(which)
        self.explorer.begin(
            which, self.crowds.bounds.normalised(self.crowds.sensed.velocity[which])
        )

    def _batch(self) -> Batch:
        settings, horizon = self.config.training, self.config.planner.horizon
        options = horizon, self.rng, settings.collision_share, settings.reflect
        if self.demonstrations is None:
            return self.replay.sample(settings.batch, *options)
        if len(self.replay) < settings.warmup:
            return self.demonstrations.sample(settings.batch, *options)
        shown = round(settings.demonstration_share * settings.batch)
        batch = self.replay.sample(settings.batch - shown, *options)
        if not shown:
            return batch
        return join(batch, self.demonstrations.sample(shown, *options))

    def save(self) -> None:
        """Write a checkpoint atomically.

        Raises:
            TrainingError: no room on the disk.
        """
        state = {
            "learner": self.learner.state(),
            "explorer": json.dumps(_plain(self.explorer.state())),
            "generator": self.explorer.generator.get_state(),
            "rng": json.dumps(self.rng.bit_generator.state),
            "mixture": json.dumps([self.mixture.success, self.mixture.episodes]),
            "counters": json.dumps([self.steps, self.seconds, self.best]),
        }
        save_checkpoint(self.folder, state)

    def restore(self) -> None:
        """Continue from the checkpoint in the run's folder."""
        state = load_checkpoint(self.folder)
        self.learner.restore(state["learner"])
        self.explorer.restore(json.loads(state["explorer"]) | {"generator": state["generator"]})
        self.rng.bit_generator.state = json.loads(state["rng"])
        self.mixture.success, self.mixture.episodes = json.loads(state["mixture"])
        self.steps, self.seconds, self.best = json.loads(state["counters"])

    def export(self, name: str, training: Mapping[str, Any]) -> None:
        """Write the world model's weights."""
        path = self.folder / f"{name}.safetensors"
        save_weights(path, self.learner.model.state_dict(), self.config, dict(training), FORMAT)


def train(
    name: str = "latent_planner",
    minutes: float | None = None,
    steps: int | None = None,
    resume: bool = False,
    seed: int = 0,
    social: bool = True,
    overrides: Mapping[str, Any] | None = None,
    config: Config | None = None,
) -> Path:
    """Train a latent planner.

    Args:
        name: of the run; its folder is ``runs/<name>``.
        minutes: wall time to train in this call.
        steps: environment steps at which to stop, those of earlier calls included.
        resume: continue the run of this name.
        seed: of parameters, episodes and exploration.
        social: whether the reward includes the social term.
        overrides: configuration fields, e.g. ``{"training.batch": 64}``.
        config: the shipped configuration by default.

    Returns:
        The run's folder with ``best.safetensors`` and ``last.safetensors``.

    Raises:
        TrainingError: nothing to resume, a run in the way, a diverged training, a full disk.
    """
    config = (config or load_config()).override(overrides or {})
    folder = RUNS / name
    with run_folder(folder, resume):
        keep_freed_memory()
        torch.set_num_threads(1)
        run = Run(folder, config, seed, social)
        if resume:
            run.restore()
        facts = {"run": name, "seed": seed, "social": social, "worlds": worlds_digest()}
        total = minutes * 60 if minutes is not None else steps if steps is not None else np.inf
        curve = CURVES / f"{name}.csv"
        if not resume:
            curve.unlink(missing_ok=True)
        with stop_on_signals() as stopping, Journal(name, folder, curve, total) as journal:
            _loop(run, journal, facts, minutes, steps, stopping)
            if stopping():
                journal.say("stopped; --resume continues this run")
            run.save()
            run.export("last", facts | {"steps": run.steps, "seconds": run.seconds})
    return folder


def _loop(
    run: Run,
    journal: Journal,
    facts: Mapping[str, Any],
    minutes: float | None,
    steps: int | None,
    stopping: Callable[[], bool],
) -> None:
    settings = run.config.training
    begun, before = time.perf_counter(), run.seconds
    sums: dict[str, torch.Tensor] = defaultdict(lambda: torch.zeros(()))
    count, owed, last_note = 0, 0.0, (run.steps, begun)
    saved = validated = time.perf_counter()

    def update() -> None:
        nonlocal count
        for key, value in run.update().items():
            sums[key] = sums[key] + value
        count += 1

    def elapsed() -> float:
        return time.perf_counter() - begun

    if run.demonstrations is not None:
        while run.learner.updates < settings.pretraining:
            update()
            if stopping():
                return
            if count % 100 == 0:
                run.learner.check(_means(sums, count))
                shares = f"{run.learner.updates}/{settings.pretraining} updates on demonstrations"
                journal.advance(elapsed() if minutes is not None else run.steps, shares)
                run.seconds = before + elapsed()
        if count:
            _validate(run, journal, facts)
            saved = validated = time.perf_counter()
    run.begin()
    while not stopping():
        run.step()
        if len(run.replay) >= settings.warmup:
            owed += settings.updates_per_step
        while owed >= 1:
            update()
            owed -= 1
        now = time.perf_counter()
        run.seconds = before + now - begun
        if now - last_note[1] > 15 and count:
            terms = _means(sums, count)
            run.learner.check(terms)
            speed = (run.steps - last_note[0]) / (now - last_note[1])
            success = float(np.mean(list(run.mixture.success.values())))
            extra = {"alpha": run.learner.alpha, "q_scale": run.learner.q_scale}
            journal.scalars({f"loss/{k}": v for k, v in (terms | extra).items()}, run.steps)
            journal.scalars({"success_in_training": success, "steps_per_s": speed}, run.steps)
            note = f"success {success:.2f}, {speed:.0f} steps/s, {run.learner.updates} updates"
            journal.advance(elapsed() if minutes is not None else run.steps, note)
            sums.clear()
            count, last_note = 0, (run.steps, now)
        done = (minutes is not None and elapsed() >= minutes * 60) or (
            steps is not None and run.steps >= steps
        )
        if done or now - validated > 60 * settings.validation_minutes:
            _validate(run, journal, facts)
            validated = time.perf_counter()
        if done:
            return
        if now - saved > 60 * settings.checkpoint_minutes:
            run.save()
            saved = time.perf_counter()


def _validate(run: Run, journal: Journal, facts: Mapping[str, Any]) -> None:
    settings = run.config.training
    with run.learner.precision():
        result = validate(
            policy_act(run.learner.model), run.config.perception.geometry,
            settings.validation_episodes,
        )  # fmt: skip
    counts = {
        "steps": run.steps, "decisions": run.explorer.decisions, "updates": run.learner.updates,
        "seconds": run.seconds,
    }  # fmt: skip
    row = journal.validated(result, counts, run.mixture.success)
    if result.mean >= run.best:
        run.best = result.mean
        run.export("best", {**facts, **row})


def _means(sums: Mapping[str, torch.Tensor], count: int) -> dict[str, float]:
    return {key: float(value) / count for key, value in sums.items()}


def _plain(state: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in state.items() if not isinstance(value, torch.Tensor)}


def save_checkpoint(folder: Path, state: Mapping[str, Any]) -> None:
    """Write a run's checkpoint atomically, with the scenarios it belongs to.

    Raises:
        TrainingError: no room on the disk.
    """
    part = folder / "checkpoint.part"
    try:
        torch.save({"worlds": worlds_digest(), **state}, part)
        part.replace(folder / "checkpoint.pt")
    except (OSError, RuntimeError) as error:
        raise TrainingError(
            f"{part}: the checkpoint could not be written ({error}); make room on the disk "
            "and resume: the previous checkpoint is intact"
        ) from error


def load_checkpoint(folder: Path) -> dict[str, Any]:
    """Read a run's checkpoint.

    Raises:
        TrainingError: the scenarios are no longer those of the run.
    """
    state = torch.load(folder / "checkpoint.pt", weights_only=True)
    if state["worlds"] != worlds_digest():
        raise TrainingError(
            f"{folder}: the scenarios have changed since this run was saved (then "
            f"{state['worlds']}, now {worlds_digest()}); train under a new name"
        )
    return state


@contextmanager
def run_folder(folder: Path, resume: bool) -> Iterator[None]:
    """Make a run's folder and keep other processes out of it.

    Raises:
        TrainingError: there is a run and ``resume`` is not asked for, or the reverse, or another
            process is training it.
    """
    there = (folder / "checkpoint.pt").is_file()
    if resume and not there:
        raise TrainingError(f"nothing to resume: {folder / 'checkpoint.pt'} does not exist")
    if not resume and there:
        raise TrainingError(f"{folder} holds a run; resume it, or remove or rename the folder")
    folder.mkdir(parents=True, exist_ok=True)
    lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        raise TrainingError(f"{folder}: another process is training this run") from None
    try:
        yield
    finally:
        os.close(lock)
