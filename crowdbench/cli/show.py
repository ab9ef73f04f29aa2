"""``crowdbench show``: how a scenario begins."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Annotated

import typer

from crowdbench.cli.common import SetOption, out
from crowdbench.cli.pictures import ScenarioArgument, SeedOption, picture, save
from crowdbench.replacing import replacing
from crowdbench.scenario import load_scenario, parse_overrides


def show(
    scenario: ScenarioArgument,
    seed: SeedOption = 0,
    overrides: SetOption = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Picture, by default SCENARIO.png.")
    ] = None,
) -> None:
    """Draw how a scenario begins."""
    world = load_scenario(scenario, **parse_overrides(overrides or []))
    path = output or Path(f"{world.name}.png")

    from PIL import Image

    from crowdbench.simulation.env import CrowdEnv

    env = CrowdEnv(world, render_mode="rgb_array")
    env.reset(seed=seed)

    def write() -> None:
        # Straight to a file, Pillow does not notice that there is no room for a JPEG.
        content = io.BytesIO()
        content.name = path.name  # says the kind
        Image.fromarray(picture(env)).save(content)
        with replacing(path) as part:
            part.write_bytes(content.getvalue())

    save(write, path)
    out().print(f"{path}: {world.name}, seed {seed}", markup=False)
