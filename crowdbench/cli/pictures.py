"""What ``crowdbench show`` and ``crowdbench record`` share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.common import UserError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from crowdbench.simulation.env import CrowdEnv

ScenarioArgument = Annotated[
    str, typer.Argument(metavar="SCENARIO", help="Name, or path of a .yaml file.")
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Episode seed.")]


def picture(env: CrowdEnv) -> NDArray[np.uint8]:
    """The present state as (H, W, 3)."""
    picture = env.render()
    assert picture is not None
    return picture


def save(write: Callable[[], object], path: Path) -> None:
    """Write a picture or video; what stands in the way becomes the user's message."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else None
        raise UserError(f"{path}: cannot be written ({reason or error})") from error
