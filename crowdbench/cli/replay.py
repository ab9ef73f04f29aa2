"""``crowdbench replay``: stored episodes in the browser."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.common import RESULTS, ResultsOption, UserError, out
from crowdbench.scenario import load_scenario

if TYPE_CHECKING:
    from crowdbench.evaluation.recordings import Recording


def replay(
    episode: Annotated[
        str, typer.Argument(metavar="SCENARIO:AGENT:SEED", help="A stored episode.")
    ],
    results: ResultsOption = RESULTS,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder of the page, by default a temporary one."),
    ] = None,
) -> None:
    """Watch stored episodes in the browser, next to what other agents did on the same seed."""
    import webbrowser

    from crowdbench.evaluation.joined import PUBLISHED
    from crowdbench.site.website import replay_link, write_replay_page

    recordings = _of_seed(episode, results)
    folder = output or Path(tempfile.mkdtemp(prefix="crowdbench-replay-"))
    site = write_replay_page(recordings, folder)
    first = recordings[0]
    link = replay_link(first.cell.scenario, first.cell.agent, first.seeds[0])
    address = site.page.resolve().as_uri() + link
    opened = webbrowser.open(address)
    hint = "" if opened else "No browser could be opened; open this in one:\n"
    out().print(f"{hint}{address}", markup=False, soft_wrap=True)
    if PUBLISHED in first.sources.values():
        out().print(f"{first.cell.agent} has not driven here; this is its published episode.")


def _of_seed(text: str, results: Path) -> list[Recording]:
    """The episode that is asked for, then those of other agents on the same seed."""
    from crowdbench.agent import AgentSpec
    from crowdbench.evaluation.joined import published_and_local
    from crowdbench.evaluation.recordings import find_recordings
    from crowdbench.evaluation.results import scenario_label

    place, _, number = text.rpartition(":")
    name, _, agent = place.partition(":")
    if not (name and agent and number.isdecimal()):
        raise UserError(f"{text!r}: expected SCENARIO:AGENT:SEED")
    seed = int(number)
    is_path = name.endswith((".yaml", ".yml"))
    label = scenario_label(load_scenario(name)) if is_path else name
    wanted = str(AgentSpec.parse(agent))
    rows = published_and_local(results, label, first="local")
    found = find_recordings(rows[rows["seed"] == seed])
    first = [recording for recording in found if recording.cell.agent == wanted]
    if not first:
        raise UserError(
            f"{results}: no commands of {wanted!r} in {label!r} with seed {seed} are stored, nor "
            f"published; run it: crowdbench run --scenario {name} --agent {agent} --seed {seed} "
            f"--episodes 1 --results {results}"
        )
    digest = first[0].cell.scenario_digest
    others = [r for r in found if r.cell.agent != wanted and r.cell.scenario_digest == digest]
    return [*first, *others]
