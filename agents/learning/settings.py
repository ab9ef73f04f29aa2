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
        agent: who is trained.
        config: its configuration.
        seed: of parameters, episodes and exploration.
        social: whether the reward includes the social term.
    """

    agent: str
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
        return self._replace(
            config=self.config.override(overrides),
            seed=self.seed if seed is None else seed,
            social=self.social if social is None else social,
        )

    def continued(
        self, overrides: Mapping[str, Any], seed: int | None, social: bool | None
    ) -> RunSettings:
        """The settings of a run that goes on from these with what a user asks for.

        Raises:
            ConfigError: unknown field or value out of range.
            TrainingError: another seed or reward than the run was begun with.
        """
        if seed not in (None, self.seed):
            raise TrainingError(
                f"--seed {seed}: the run was begun with {self.seed}; leave it out, or train under "
                "a new name"
            )
        if social not in (None, self.social):
            option = "--social" if social else "--no-social"
            raise TrainingError(
                f"{option}: the run was begun otherwise; leave it out, or train under a new name"
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
        return self._asdict() | {"config": self.config.model_dump(mode="json")}

    @classmethod
    def read(cls, document: Mapping[str, Any], source: str) -> RunSettings:
        """What ``document`` gave.

        Raises:
            ConfigError: fields that there no longer are; the message names the source.
        """
        return cls(**{**document, "config": parse_config(document["config"], source)})


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
