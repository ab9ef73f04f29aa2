"""The training loop of all learned agents: how a run begins, goes on and ends, whatever it trains.

Many environments run in one process. Each round every environment takes one step, the step goes
into the replay, and the networks are updated. Demonstrations come first and stay in each batch.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import torch
from crowdbench_agents.learning.checkpoints import (
    CHECKPOINT,
    load_checkpoint,
    require_same_scenarios,
    run_folder,
    run_name,
)
from crowdbench_agents.learning.detour import require_straight_ways
from crowdbench_agents.learning.device import (
    describe_actors,
    find_actors,
    find_device,
    learner_threads,
)
from crowdbench_agents.learning.errors import TrainingError
from crowdbench_agents.learning.journal import Journal, describe_spent, stop_on_signals
from crowdbench_agents.learning.kind import Kind
from crowdbench_agents.learning.memory import keep_freed_memory
from crowdbench_agents.learning.run import TrainingRun
from crowdbench_agents.learning.settings import RunSettings, require_expert
from crowdbench_agents.learning.worlds import digests, training_worlds

from crowdbench.messages import short

RUNS, CURVES = Path("runs"), Path("results/training")
NOTE_SECONDS = 15  # between notes on progress
TELL_SECONDS = 60  # between lines that tell where the time goes
CHECK_UPDATES = 100  # between checks, and notes, while learning from demonstrations alone


def train(
    kind: Kind,
    name: str,
    defaults: RunSettings,
    *,
    overrides: Mapping[str, Any] | None = None,
    minutes: float | None = None,
    steps: int | None = None,
    resume: bool = False,
    seed: int | None = None,
    social: bool | None = None,
    device: str = "auto",
    actors: int | None = None,
) -> Path:
    """Train an agent.

    Args:
        kind: of agent.
        name: of the run; its folder is ``runs/<name>``. Letters, digits and _.- only.
        defaults: settings of a run of this kind where nothing else is asked for.
        overrides: fields of the configuration, e.g. ``{"training.batch": 64}``; a run that is
            resumed keeps all others.
        minutes: wall time to train in this call.
        steps: environment steps at which to stop, those of earlier calls included.
        resume: continue the run of this name.
        seed: of parameters, episodes and exploration.
        social: whether the reward includes the social term.
        device: where networks are trained: cpu, cuda, or auto for a GPU where there is one.
        actors: processes that act while this one learns; with 0 it acts itself, in turn with
            learning, and the same seed gives the same run. None leaves the number to the machine.

    Returns:
        The run's folder with ``best.safetensors`` and ``last.safetensors``.

    Raises:
        ConfigError: unknown field or value out of range.
        TrainingError: a name that no run can have, nothing to resume, a run in the way, a
            checkpoint that cannot be used, another seed or reward than that of the run, no such
            expert, a diverged training, a full disk, no such device or too little memory on it,
            actors that die again and again.
    """
    where = find_device(device)
    folder, curve = RUNS / run_name(name), CURVES / f"{name}.csv"
    asked = overrides or {}, seed, social
    try:
        with ExitStack() as stack:
            # What cannot begin is refused before anything is made or removed.
            if resume:
                stack.enter_context(run_folder(folder, resume))
                state, scenarios = load_checkpoint(folder, kind.form)
                source = f"{folder / CHECKPOINT}: the run's settings"
                before = RunSettings.read(state["settings"], source)
                if before.agent != defaults.agent:
                    raise TrainingError(
                        f"{folder}: is a run of {before.agent}, not of {defaults.agent}"
                    )
                settings = before.continued(*asked)
            else:
                before = settings = defaults.chosen(*asked)
            config = settings.config
            worlds = training_worlds(config.training)
            if resume:
                require_same_scenarios(folder, scenarios, digests(worlds))
            require_expert(config.training)
            require_straight_ways(config.training.detour_price, worlds)
            count = find_actors(actors, config.training.environments, where)
            if not resume:
                stack.enter_context(run_folder(folder, resume))
            keep_freed_memory()
            torch.set_num_threads(learner_threads(count, where))
            total = minutes * 60 if minutes is not None else steps if steps is not None else np.inf
            journal = stack.enter_context(Journal(name, folder, curve, total))
            stopping = stack.enter_context(stop_on_signals())
            run = TrainingRun(kind, folder, settings, where, count)
            if resume:
                run.restore(state)
            else:
                curve.unlink(missing_ok=True)
            for change in settings.changes(before):
                journal.say(change)
            if run.demonstrations is not None:
                wanted = config.training.demonstrations
                run.demonstrations.record(lambda there: journal.recorded(there, wanted), stopping)
            arithmetic = run.facts["arithmetic"]
            journal.say(f"{where.type}, {describe_actors(count)}, networks learn in {arithmetic}")
            try:
                if not stopping():
                    _loop(run, journal, minutes, steps, stopping)
            finally:
                run.close()
            if stopping():
                journal.say("stopped; --resume continues this run")
            run.save()
            run.export("last", {"steps": run.steps, "seconds": run.seconds})
    except torch.OutOfMemoryError as error:
        raise TrainingError(
            f"device: the memory of the GPU does not suffice ({short(str(error))}); lower "
            "training.batch or use --device cpu"
        ) from error
    return folder


def _loop(
    run: TrainingRun,
    journal: Journal,
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

    def means() -> dict[str, float]:
        return {key: float(value) / count for key, value in sums.items()}

    def elapsed() -> float:
        return time.perf_counter() - begun

    if run.demonstrations is not None:
        while run.updates < settings.pretraining:
            update()
            if stopping():
                return
            if count % CHECK_UPDATES == 0:
                run.check(means())
                shares = f"{run.updates}/{settings.pretraining} updates on demonstrations"
                journal.advance(elapsed() if minutes is not None else run.steps, shares)
                run.seconds = before + elapsed()
        if count:
            run.validate(journal)
            saved = validated = time.perf_counter()
    told = time.perf_counter()
    run.spent()
    run.begin(journal.say, stopping)
    while not stopping():
        run.step()
        if run.updates_begin:
            owed += settings.updates_per_step
        while owed >= 1:
            update()
            owed -= 1
        now = time.perf_counter()
        run.seconds = before + now - begun
        if now - told > TELL_SECONDS:
            journal.say(describe_spent(run.spent(), now - told))
            told = now
        if now - last_note[1] > NOTE_SECONDS and count:
            terms = means()
            run.check(terms)
            speed = (run.steps - last_note[0]) / (now - last_note[1])
            success = float(np.mean(list(run.sampler.success.values())))
            losses = {f"loss/{key}": value for key, value in (terms | run.scalars()).items()}
            journal.scalars(losses, run.steps)
            journal.scalars({"success_in_training": success, "steps_per_s": speed}, run.steps)
            note = f"success {success:.2f}, {speed:.0f} steps/s, {run.updates} updates"
            journal.advance(elapsed() if minutes is not None else run.steps, note)
            sums.clear()
            count, last_note = 0, (run.steps, now)
        done = (minutes is not None and elapsed() >= minutes * 60) or (
            steps is not None and run.steps >= steps
        )
        if done or now - validated > 60 * settings.validation_minutes:
            run.validate(journal)
            validated = time.perf_counter()
        if done:
            return
        if now - saved > 60 * settings.checkpoint_minutes:
            if count:
                run.check(means())
            run.save()
            saved = time.perf_counter()
