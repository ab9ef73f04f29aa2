"""``crowdbench train``: hands over to the trainer that an agent brings."""

from __future__ import annotations

import inspect
from typing import Annotated

import typer

from crowdbench.cli.common import SetOption, UserError, out
from crowdbench.messages import nearest
from crowdbench.scenario import parse_overrides

ENTRY_POINT_GROUP = "crowdbench.trainers"


def train(
    trainer: Annotated[str, typer.Argument(metavar="NAME", help="The agent to train.")],
    name: Annotated[
        str | None, typer.Option("--name", help="Name of the run, by default the agent's.")
    ] = None,
    minutes: Annotated[
        float | None, typer.Option(min=0, help="Wall time to train, without end by default.")
    ] = None,
    steps: Annotated[
        int | None, typer.Option(min=0, help="Environment steps at which to stop.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of parameters, episodes, exploration.")] = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the run.")] = False,
    social: Annotated[
        bool | None,
        typer.Option("--social/--no-social", help="Reward yielding; the trainer's own default."),
    ] = None,
    device: Annotated[
        str | None, typer.Option(help="Where networks are trained: auto, cpu or cuda.")
    ] = None,
    actors: Annotated[
        int | None,
        typer.Option(min=0, help="Processes that act, by default half of the cores; 0: none."),
    ] = None,
    overrides: SetOption = None,
) -> None:
    """Train an agent.

    The run goes to runs/NAME, its curve to results/training/NAME.csv.
    """
    from importlib.metadata import entry_points

    points = {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}
    if trainer not in points:
        raise UserError(f"nothing to train is called {trainer!r}{nearest(trainer, sorted(points))}")
    point = points[trainer]
    try:
        function = point.load()
    except ImportError as error:
        raise UserError(f"{trainer}: {error}; is the extra 'train' installed?") from error
    asked = {"social": social, "device": device, "actors": actors}
    # Trainers have defaults of their own, and need not know what is not asked for.
    chosen = {key: value for key, value in asked.items() if value is not None}
    parameters = inspect.signature(function).parameters
    takes_all = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
    for key in chosen:
        if key not in parameters and not takes_all:
            raise UserError(f"{trainer}: --{key} is nothing that its trainer takes")
    try:
        folder = function(
            name=trainer if name is None else name,
            minutes=minutes,
            steps=steps,
            resume=resume,
            seed=seed,
            overrides=parse_overrides(overrides or []),
            **chosen,
        )
    except Exception as error:
        # What the trainer's own package raises was written for the user; the rest is a bug.
        if type(error).__module__.partition(".")[0] != point.module.partition(".")[0]:
            raise
        raise UserError(f"{trainer}: {error}") from error
    out().print(f"{folder}: the run of {trainer}", markup=False)
