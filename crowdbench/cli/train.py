"""``crowdbench train``: hands over to the trainer that an agent brings."""

from __future__ import annotations

import re
from typing import Annotated, Any

import typer

from crowdbench.cli.common import AddressOption, UserError, err, out
from crowdbench.cli.trainers import RUNS, Trainer
from crowdbench.messages import short
from crowdbench.scenario import parse_overrides

MOST_RUNS = 1000
"""Of one command."""


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
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Of parameters, episodes, exploration; by default 0."),
    ] = None,
    seeds: Annotated[
        str | None,
        typer.Option(
            metavar="A-B",
            help="With --executor ray: a run for each seed from A to B, or of A,B, called NAME-A.",
        ),
    ] = None,
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
    executor: Annotated[
        str,
        typer.Option(metavar="NAME", help="Where runs are trained: local or ray."),
    ] = "local",
    address: AddressOption = None,
    overrides: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Override a setting, e.g. training.batch=64."
        ),
    ] = None,
) -> None:
    """Train an agent.

    The run goes to runs/NAME, its curve to results/training/NAME.csv.
    """
    function = Trainer(trainer)
    if seed is None and function.needs("seed"):
        seed = 0
    asked = {"seed": seed, "social": social, "device": device, "actors": actors}
    # Trainers have defaults of their own, and need not know what is not asked for.
    chosen = {key: value for key, value in asked.items() if value is not None}
    for key in chosen:
        if not function.takes(key):
            raise UserError(f"{trainer}: --{key} is nothing that its trainer takes")
    called = trainer if name is None else name
    run = {
        "name": called, "minutes": minutes, "steps": steps, "resume": resume,
        "overrides": parse_overrides(overrides or []), **chosen,
    }  # fmt: skip
    if executor == "local":
        if seeds is not None or address is not None:
            raise UserError("--seeds and --address are for --executor ray, with or without others")
        folder = function.train(run)
        out().print(f"{folder}: the run of {trainer}", markup=False)
        return
    if executor != "ray":
        raise UserError(f"--executor {short(executor)}: trainings run on local or ray")
    if minutes is None and steps is None:
        raise UserError("--minutes or --steps: --executor ray needs one, so that a run ends")
    if function.takes("actors"):
        run.setdefault("actors", 0)  # several runs side by side make the most of processors
    runs = [run]
    if seeds is not None:
        runs = [run | {"name": f"{called}-{one}", "seed": one} for one in _read_seeds(seeds)]
    _train_on_ray(trainer, runs, address)


def _train_on_ray(trainer: str, runs: list[dict[str, Any]], address: str | None) -> None:
    from crowdbench.cli.train_on_ray import train_on_ray

    failed = False
    for name, error in train_on_ray(trainer, runs, address):
        if error:
            failed = True
            err().print(f"{name}: {error}", style="bold red", markup=False, soft_wrap=True)
        else:
            out().print(f"{RUNS / name}: the run of {trainer}", markup=False)
    if failed:
        raise typer.Exit(1)


def _read_seeds(text: str) -> list[int]:
    """The seeds that A-B, or A,B,... names.

    Raises:
        UserError: it is something else, or too many.
    """
    if re.fullmatch(r"\d{1,9}(,\d{1,9})*", text, re.ASCII):
        return list(dict.fromkeys(map(int, text.split(","))))
    match = re.fullmatch(r"(\d{1,9})-(\d{1,9})", text, re.ASCII)
    seeds = range(int(match[1]), int(match[2]) + 1) if match else range(0)
    if not 0 < len(seeds) <= MOST_RUNS:
        raise UserError(
            f"--seeds {short(text)}: expected A-B, at most {MOST_RUNS} seeds, or A,B,..., e.g. 0-4"
        )
    return list(seeds)
