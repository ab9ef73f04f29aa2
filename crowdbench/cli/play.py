"""``crowdbench play``: a person drives the robot."""

from __future__ import annotations

from typing import Annotated

import typer

from crowdbench.cli.common import RESULTS, ResultsOption, SetOption, UserError, out
from crowdbench.scenario import load_scenario, parse_overrides


def play(
    scenario: Annotated[str, typer.Argument(metavar="SCENARIO", help="Name, or a .yaml file.")],
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Episode seed, by default the first that nobody has driven."),
    ] = None,
    overrides: SetOption = None,
    results: ResultsOption = RESULTS,
) -> None:
    """Drive the robot with the arrow keys; the episode is stored as agent "human"."""
    world = load_scenario(scenario, **parse_overrides(overrides or []))
    if world.robots.count != 1:
        raise UserError(
            f"{world.name} has {world.robots.count} robots and a person drives one; "
            "add --set robots.count=1"
        )

    from crowdbench.evaluation import human
    from crowdbench.evaluation.database import require_writable
    from crowdbench.evaluation.results import ResultsStore

    require_writable(results)
    if seed is None:
        seed = human.next_seed(world, results)
    cell = human.human_cell(world)
    if seed in ResultsStore(results).stored(cell):
        raise UserError(
            f"{results}: somebody has driven {cell.scenario} with seed {seed} already; choose "
            "another --seed, or none for the next"
        )
    console = out()
    console.print(f"{world.name}, seed {seed}: arrow keys or WASD drive, shift slows, Esc ends.")
    try:
        episode = human.drive(world, seed)
    except human.NoDisplayError as error:
        raise UserError(str(error)) from error
    except human.QuitError:
        console.print("Left before the end; nothing is stored.")
        return
    path = human.store_drive(world, episode, results)
    seconds = episode.steps * episode.control_period
    console.print(
        f"{episode.outcome} after {seconds:.1f} s; stored in {path}\n"
        f"crowdbench replay {cell.scenario}:{human.HUMAN}:{seed} --results {results} shows it.",
        markup=False,
        soft_wrap=True,
    )
