"""Kinds of fields that a scenario has, and what its sections have in common."""

from __future__ import annotations

from typing import Annotated, Any, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
)

from crowdbench.messages import Form
from crowdbench.registry import Registry


def _whole(value: Any) -> Any:
    """Take 12.0 for 12, as YAML writes 1.2e1."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError(f"the lower bound {pair[0]} exceeds the upper {pair[1]}")
    return pair


def known(registry: Registry[Any]) -> AfterValidator:
    """Refuse a name that nothing has; what it stands for loads when an environment is made."""

    def check(name: str) -> str:
        if name not in registry:
            raise ValueError(registry.unknown(name))
        return name

    return AfterValidator(check)


T = TypeVar("T")
Whole = BeforeValidator(_whole)
Text = Annotated[str, Field(strict=True)]
# Strict: text and truth values are no numbers.
Number = Annotated[float, Field(strict=True)]
Positive = Annotated[Number, Field(ge=0.001)]
NonNegative = Annotated[Number, Field(ge=0)]
Size = Annotated[Number, Field(ge=0.001, le=20)]
Speed = Annotated[Number, Field(ge=0, le=10)]
Signed = Annotated[Number, Field(ge=-20, le=20)]
Share = Annotated[Number, Field(ge=0, le=1)]
Weight = Annotated[Number, Field(ge=-1_000_000, le=1_000_000)]
Range = Annotated[tuple[T, T], AfterValidator(_ordered), Form("two numbers, lowest then highest")]
OneOrRange = Annotated[
    # Names of branches in brackets are left out of messages.
    Annotated[T, Tag("<number>")] | Annotated[Range[T], Tag("<range>")],
    Discriminator(lambda value: "<range>" if isinstance(value, list | tuple) else "<number>"),
]
Pair = Annotated[tuple[T, T], Form("two numbers, one for each number of an action")]
_Offset = Annotated[Number, Field(ge=-3.15, le=3.15)]
Mount = Annotated[
    tuple[_Offset, _Offset, _Offset], Form("three numbers, x and y [m] and heading [rad]")
]
"""A pose on the robot: ahead, to the left, and turned left."""


class Section(BaseModel):
    """Immutable; unknown keys and numbers that are not finite are refused."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, validate_default=True, allow_inf_nan=False
    )
