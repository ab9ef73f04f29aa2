"""What a run keeps to from its beginning on, whoever resumes it and wherever."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from crowdbench_agents.learning.config import Config, Training, parse_config
from crowdbench_agents.learning.errors import TrainingError

import crowdbench
from crowdbench.messages import setting


class RunSettings(NamedTuple):
    """All that decides what a run learns.

    Attributes:
        config: its configuration.
        seed: of parameters, episodes and exploration.
        social: whether the reward includes the social term.
    """

    config: Config
    seed: int = 0
    social: bool = True

    def chosen(
        self, overrides: Mapping[str, Any], seed: int | None, social: bool | None
    ) -> RunSettings:
        """The settings of a run that begins with what a user asks for; None leaves these.

        Raises:
            ConfigError: unknown field or value out of range.
        """
        return RunSettings(
            self.config.override(overrides),
            self.seed if seed is None else seed,
            self.social if social is None else social,
        )

    def continued(
        self, overrides: Mapping[str, Any], seed: int | None, social: bool | None
    ) -> RunSettings:
        """The settings of a run that goes on from these with what a user asks for.

        Raises:
            ConfigError: unknown field or value out of range.
            TrainingError: another seed or reward than the run was begun with.
        """
        asked = {"--seed": (seed, self.seed), "--social": (social, self.social)}
        for option, (now, then) in asked.items():
            if now not in (None, then):
                raise TrainingError(
                    f"{option}: the run was begun with {setting(then)}, not {setting(now)}; resume "
                    "it without, or train under a new name"
                )
        return self._replace(config=self.config.override(overrides))

    def changes(self, before: RunSettings) -> list[str]:
        """Each field of the configuration that is no longer what it was, as a line."""
        then = before.config.model_dump(mode="json")
        return [
            f"{section}.{name}: {setting(value)} from here on, {setting(old)} before"
            for section, fields in self.config.model_dump(mode="json").items()
            for name, value in fields.items()
            if value != (old := then[section][name])
        ]

    def document(self) -> dict[str, Any]:
        """As mappings, lists, numbers and text."""
        return {
            "config": self.config.model_dump(mode="json"), "seed": self.seed, "social": self.social
        }  # fmt: skip

    @classmethod
    def read(cls, document: Mapping[str, Any], source: str) -> RunSettings:
        """What ``document`` gave.

        Raises:
            ConfigError: fields that there no longer are; the message names the source.
        """
        config = parse_config(document["config"], source)
        return cls(config, document["seed"], document["social"])


def require_expert(settings: Training) -> None:
    """Make sure that the expert can be made, where there is one to demonstrate or label.

    Raises:
        TrainingError: it cannot.
    """
    if not (settings.demonstrations or settings.labelled_environments):
        return
    try:
        crowdbench.AgentSpec.parse(settings.expert).make()
    except crowdbench.AgentError as error:
        raise TrainingError(f"training.expert: {error}") from error
