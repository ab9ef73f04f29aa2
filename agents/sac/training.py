"""Training of SAC with Stable-Baselines3, on the latent planner's observations and episodes.

The encoder, the mixture of scenarios, the discount, the reward scale, the reflection, the
multi-step returns, the demonstrations and the teacher's advice are the latent planner's; the
learning algorithm is Stable-Baselines3's, with the imitation of the teacher added to the actor's
loss.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from crowdbench_agents.latent_planner.config import Config, load_config
from crowdbench_agents.latent_planner.crowds import Crowds, worlds_digest
from crowdbench_agents.latent_planner.demonstrations import Teachers, open_replays
from crowdbench_agents.latent_planner.learner import TrainingError
from crowdbench_agents.latent_planner.memory import keep_freed_memory
from crowdbench_agents.latent_planner.progress import Journal, stop_on_signals
from crowdbench_agents.latent_planner.training import (
    CURVES,
    RUNS,
    Mixture,
    load_checkpoint,
    run_folder,
    save_checkpoint,
)
from crowdbench_agents.latent_planner.validation import Moment, validate
from crowdbench_agents.latent_planner.weights import save_weights
from crowdbench_agents.latent_planner.world_model import Inputs
from crowdbench_agents.sac.adapters import CrowdReplay, CrowdVecEnv, MapFeatures
from crowdbench_agents.sac.networks import FORMAT, SacActor
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger

BATCH = 256


class Keeper(BaseCallback):
    """Validates, saves and ends the training."""

    def __init__(
        self,
        run: SacRun,
        journal: Journal,
        minutes: float | None,
        steps: int | None,
        stopping: Callable[[], bool],
    ) -> None:
        super().__init__()
        self._stopping = stopping
        self._run, self._journal, self._minutes, self._steps = run, journal, minutes, steps
        self._begun = self._saved = self._validated = self._noted = time.perf_counter()
        self._before, self._noted_steps = run.seconds, run.model.num_timesteps

    def _on_step(self) -> bool:
        if self._stopping():
            return False
        run, now = self._run, time.perf_counter()
        settings = run.config.training
        elapsed, steps = now - self._begun, run.model.num_timesteps
        run.seconds = self._before + elapsed
        if now - self._noted > 15:
            speed = (steps - self._noted_steps) / (now - self._noted)
            success = float(np.mean(list(run.mixture.success.values())))
            alpha = float(run.model.log_ent_coef.detach().exp())
            run.check()
            self._journal.scalars({"success_in_training": success, "alpha": alpha}, steps)
            note = f"success {success:.2f}, {speed:.0f} steps/s, {run.model._n_updates} updates"
            self._journal.advance(elapsed if self._minutes is not None else steps, note)
            self._noted, self._noted_steps = now, steps
        done = (self._minutes is not None and elapsed >= self._minutes * 60) or (
            self._steps is not None and steps >= self._steps
        )
        if done or now - self._validated > 60 * settings.validation_minutes:
            run.validate(self._journal)
            self._validated = time.perf_counter()
        if not done and now - self._saved > 60 * settings.checkpoint_minutes:
            run.save()
            self._saved = time.perf_counter()
        return not done


class SacRun:
    """One training run and all that has to survive an interruption."""

    def __init__(
        self, folder: Path, config: Config, seed: int, social: bool, facts: dict[str, Any]
    ) -> None:
        self.folder, self.config, self._facts = folder, config, facts
        settings, geometry = config.training, config.perception.geometry
        self.mixture = Mixture(seed)
        self.rng = np.random.default_rng([seed, 2])
        count = settings.environments
        crowds = Crowds(count, self.mixture, geometry)
        self.replay, demonstrations = open_replays(folder, config, crowds, social)
        taught = np.arange(count - settings.taught_environments, count)
        features = {
            "cells": geometry.cells, "settings": config.model, "bfloat16": settings.bfloat16,
        }  # fmt: skip
        target = config.loss.entropy_target
        self.model = SAC(
            "MultiInputPolicy",
            CrowdVecEnv(crowds, self.mixture, Teachers(settings.teacher, crowds, taught)),
            learning_rate=settings.learning_rate,
            # With demonstrations there is something to learn from, and a policy, at once.
            learning_starts=0 if demonstrations else settings.warmup,
            batch_size=BATCH,
            tau=settings.target_rate,
            gamma=config.loss.discount,
            train_freq=1,
            gradient_steps=max(1, round(settings.updates_per_step)),
            replay_buffer_class=CrowdReplay,
            replay_buffer_kwargs={
                "config": config, "replay": self.replay, "demonstrations": demonstrations,
                "rng": self.rng,
            },
            ent_coef=f"auto_{config.loss.entropy}",
            target_entropy="auto" if target is None else target,
            policy_kwargs={
                "net_arch": [config.model.hidden, config.model.hidden],
                "features_extractor_class": MapFeatures,
                "features_extractor_kwargs": features,
            },
            seed=seed,
            device="cpu",
        )  # fmt: skip
        self.model.set_logger(Logger(None, []))
        self.model.lr_schedule = lambda _progress: (
            settings.learning_rate * config.learning_rate_factor(self.model._n_updates)
        )
        self.model.actor.optimizer.register_step_pre_hook(lambda *_: self.imitate())
        self.seconds, self.best = 0.0, -1.0

    def imitate(self) -> None:
        """Add the gradient of teaching x |a - a_teacher|^2, averaged over the batch.

        As in the latent planner's policy loss, a is drawn from the policy.
        """
        batch = self.model.replay_buffer.advice
        weight = self.config.teaching(self.model._n_updates)
        taught = np.flatnonzero(batch.taught[0])
        if weight == 0 or not len(taught):
            return
        seen = {key: value[0][taught] for key, value in batch.inputs._asdict().items()}
        action, _ = self.model.actor.action_log_prob(seen)
        error = (action - batch.reference[0][taught]).square().sum(dim=-1)
        (weight * error.sum() / len(batch.taught[0])).backward()

    def pretrain(self, journal: Journal, stopping: Callable[[], bool]) -> None:
        """Updates on the demonstrations, where there are any, before acting."""
        settings, begun, before = self.config.training, time.perf_counter(), self.seconds
        wanted = settings.pretraining if settings.demonstrations else 0
        while self.model._n_updates < wanted and not stopping():
            self.model.train(min(100, wanted - self.model._n_updates), BATCH)
            self.check()
            self.seconds = before + time.perf_counter() - begun
            journal.advance(0.0, f"{self.model._n_updates}/{wanted} updates on demonstrations")

    def actor(self) -> SacActor:
        """The present actor on its own."""
        source = self.model.policy.actor
        actor = SacActor(self.config.perception.cells, self.config.model)
        actor.encoder.load_state_dict(source.features_extractor.encoder.state_dict())
        actor.hidden.load_state_dict(source.latent_pi.state_dict())
        actor.mean.load_state_dict(source.mu.state_dict())
        return actor.eval().requires_grad_(False)

    def check(self) -> None:
        """Stop a training that has diverged.

        Raises:
            TrainingError: a parameter is not finite.
        """
        if not all(torch.isfinite(p).all() for p in self.model.policy.parameters()):
            raise TrainingError("a parameter is not finite; lower the learning rate and resume")

    def validate(self, journal: Journal) -> None:
        """Success of the actor on validation seeds; keeps the best."""
        actor = self.actor()

        def act(moment: Moment) -> np.ndarray:
            return actor(Inputs(*map(torch.from_numpy, moment.sensed))).numpy()

        settings = self.config.training
        result = validate(act, self.config.perception.geometry, settings.validation_episodes)
        steps = self.model.num_timesteps
        counts = {
            "steps": steps, "decisions": steps, "updates": self.model._n_updates,
            "seconds": self.seconds,
        }  # fmt: skip
        row = journal.validated(result, counts, self.mixture.success)
        if result.mean >= self.best:
            self.best = result.mean
            self.export("best", row)

    def export(self, name: str, row: Mapping[str, Any]) -> None:
        """Write the actor's weights."""
        path = self.folder / f"{name}.safetensors"
        save_weights(path, self.actor().state_dict(), self.config, {**self._facts, **row}, FORMAT)

    def save(self) -> None:
        """Write a checkpoint atomically.

        Raises:
            TrainingError: no room on the disk.
        """
        model = self.model
        state = {
            "policy": model.policy.state_dict(),
            "actor_optimizer": model.actor.optimizer.state_dict(),
            "critic_optimizer": model.critic.optimizer.state_dict(),
            "alpha_optimizer": model.ent_coef_optimizer.state_dict(),
            "log_alpha": model.log_ent_coef.detach().clone(),
            "torch_rng": torch.get_rng_state(),
            "rng": json.dumps(self.rng.bit_generator.state),
            "mixture": json.dumps([self.mixture.success, self.mixture.episodes]),
            "counters": json.dumps(
                [model.num_timesteps, model._n_updates, self.seconds, self.best]
            ),
        }
        save_checkpoint(self.folder, state)

    def restore(self) -> None:
        """Continue from the checkpoint in the run's folder."""
        state, model = load_checkpoint(self.folder), self.model
        model.policy.load_state_dict(state["policy"])
        model.actor.optimizer.load_state_dict(state["actor_optimizer"])
        model.critic.optimizer.load_state_dict(state["critic_optimizer"])
        model.ent_coef_optimizer.load_state_dict(state["alpha_optimizer"])
        with torch.no_grad():
            model.log_ent_coef.copy_(state["log_alpha"])
        torch.set_rng_state(state["torch_rng"])
        self.rng.bit_generator.state = json.loads(state["rng"])
        self.mixture.success, self.mixture.episodes = json.loads(state["mixture"])
        counters = json.loads(state["counters"])
        model.num_timesteps, model._n_updates, self.seconds, self.best = counters


def train(
    name: str = "sac",
    minutes: float | None = None,
    steps: int | None = None,
    resume: bool = False,
    seed: int = 0,
    social: bool = True,
    overrides: Mapping[str, Any] | None = None,
) -> Path:
    """Train SAC; arguments as for the latent planner.

    Raises:
        TrainingError: nothing to resume, a run in the way, a diverged training, a full disk.
    """
    config = load_config().override(overrides or {})
    folder, curve = RUNS / name, CURVES / f"{name}.csv"
    with run_folder(folder, resume):
        keep_freed_memory()
        torch.set_num_threads(1)
        facts = {"run": name, "seed": seed, "social": social, "worlds": worlds_digest()}
        run = SacRun(folder, config, seed, social, facts)
        if resume:
            run.restore()
        else:
            curve.unlink(missing_ok=True)
        run.replay.cut()
        total = minutes * 60 if minutes is not None else steps if steps is not None else np.inf
        with stop_on_signals() as stopping, Journal(name, folder, curve, total) as journal:
            run.pretrain(journal, stopping)
            if not stopping():
                run.model.learn(
                    total_timesteps=10**12,
                    callback=Keeper(run, journal, minutes, steps, stopping),
                    reset_num_timesteps=False,
                )
            if stopping():
                journal.say("stopped; --resume continues this run")
            run.save()
            run.export("last", {"steps": run.model.num_timesteps, "seconds": run.seconds})
    return folder
