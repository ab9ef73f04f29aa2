"""A scenario: every section together, and whether they fit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, ValidationError, model_validator

from crowdbench.messages import Form, explain, quoted
from crowdbench.scenario import crowd, maps, recorded, room, streams
from crowdbench.scenario.changes import change
from crowdbench.scenario.decided import leave_decided
from crowdbench.scenario.digest import digest
from crowdbench.scenario.errors import ScenarioError
from crowdbench.scenario.fields import Positive, Section, Text, Whole
from crowdbench.scenario.people import Pedestrians
from crowdbench.scenario.sections import Arena, Lidar, Obstacles, Reward, Robots

MAX_STEPS = 100_000
"""Control steps of an episode, at most."""


class Scenario(Section):
    """One world to be crossed, complete and immutable.

    Together with an episode seed it fixes everything that happens except what agents decide.
    """

    name: Annotated[Text, Form("1 to 100 letters, digits and _.-")] = Field(
        min_length=1,
        max_length=100,
        pattern=r"^[A-Za-z0-9_.-]+$",
        description="letters, digits and _.-; by default the file's",
    )
    description: Text = Field("", description="what it is like, in a line")
    control_period: Positive = Field(0.2, le=2, description="time between two actions [s]")
    substeps: Annotated[int, Field(ge=1, le=50, strict=True), Whole] = Field(
        4, description="physics steps per control period, at least; fast or small bodies take more"
    )
    time_limit: Positive = Field(40.0, le=3600, description="after which an episode ends [s]")
    arena: Arena = Arena()
    robots: Robots = Robots()
    lidar: Lidar = Lidar()
    obstacles: Obstacles = Obstacles()
    pedestrians: Pedestrians = Pedestrians()
    reward: Reward = Reward()

    @property
    def max_steps(self) -> int:
        """Control steps until the time limit."""
        return max(1, round(self.time_limit / self.control_period))

    @property
    def digest(self) -> str:
        """12 hex digits that change whenever anything about the world changes.

        Name, description and reward weights are left out: they do not change what happens.
        ``later`` fields count only where they differ from their defaults.
        """
        return digest(self, plain=type(self)(name=self.name))

    def override(self, changes: Mapping[str, Any]) -> Scenario:
        """Return a copy with some fields replaced, e.g. ``{"pedestrians.count": 12}``.

        Raises:
            ScenarioError: unknown field, value out of range, or one that a recording decides; an
                image for a map that has polygons or walls, without saying which of them stay. A map
                that was read from an image is one of polygons, and can be changed like one.
        """
        document = self.model_dump()
        change(document, changes)
        leave_decided(document, changes, source=self.name)
        return validate(document, source=self.name)

    @model_validator(mode="before")
    @classmethod
    def _image_read(cls, document: Any) -> Any:
        """What an image shows stands in the scenario from here on; its files are read once."""
        if not isinstance(document, dict):
            return document
        arena = document.get("arena")
        arena = arena.model_dump() if isinstance(arena, Arena) else arena
        return (
            {**document, "arena": maps.with_image(arena)} if isinstance(arena, dict) else document
        )

    @model_validator(mode="after")
    def _it_ends(self) -> Scenario:
        if self.time_limit > (MAX_STEPS + 0.5) * self.control_period:
            raise ValueError(
                f"time_limit {self.time_limit:g} s at control_period {self.control_period:g} s: "
                f"an episode has at most {MAX_STEPS:,} steps; allowed: control_period >= "
                f"{self.time_limit / MAX_STEPS:g} or time_limit <= "
                f"{MAX_STEPS * self.control_period:g}"
            )
        return self

    @model_validator(mode="after")
    def _as_recorded(self) -> Scenario:
        for name, fields in recorded.completed(self).items():
            self.__dict__[name] = getattr(self, name).model_copy(update=fields)
        return self

    @model_validator(mode="after")
    def _everybody_fits(self) -> Scenario:
        checks = maps.misplaced, streams.misrouted, room.misfit, crowd.misfit
        if problem := next(filter(None, (check(self) for check in checks)), ""):
            raise ValueError(problem)
        return self


def validate(document: dict[str, Any], source: str) -> Scenario:
    """Make a scenario of a document.

    Raises:
        ScenarioError: names the source, the fields and what is allowed.
    """
    try:
        return Scenario.model_validate(document)
    except ValidationError as error:
        raise ScenarioError(f"scenario {quoted(source)}: {explain(error, Scenario)}") from error
