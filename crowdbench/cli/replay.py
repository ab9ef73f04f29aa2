"""``crowdbench replay``: stored episodes in the browser."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.common import RESULTS, ResultsOption, UserError, out
from crowdbench.scenario import load_scenario

if TYPE_CHECKING:
    from crowdbench.site.replay import Recording

_FORMS = "expected a trajectory file (.jsonl.gz) or SCENARIO:AGENT:SEED"


def replay(
    episode: Annotated[
        str, typer.Argument(metavar="FILE|SCENARIO:AGENT:SEED", help="A stored episode.")
    ],
    results: ResultsOption = RESULTS,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder of the page, by default a temporary one."),
    ] = None,
) -> None:
    """Watch stored episodes in the browser, next to what other agents did on the same seed."""
    import webbrowser

    from crowdbench.site.website import replay_link, write_replay_page

    path = Path(episode)
    recordings = _of_file(path) if _is_file(path) else _of_seed(episode, results)
    folder = output or Path(tempfile.mkdtemp(prefix="crowdbench-replay-"))
    site = write_replay_page(recordings, folder)
    first = recordings[0]
    seed, robot = first.entries[0][:2]
    link = replay_link(first.scenario, first.agent, seed, robot)
    address = site.page.resolve().as_uri() + link
    opened = webbrowser.open(address)
    hint = "" if opened else "No browser could be opened; open this in one:\n"
    out().print(f"{hint}{address}", markup=False, soft_wrap=True)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # too long for a name
        return False


def _of_file(path: Path) -> list[Recording]:
    from crowdbench.site.replay import find_recording

    recording = find_recording(path.resolve())
    if recording is None:
        raise UserError(f"{path}: holds no episodes")
    return [recording]


def _of_seed(text: str, results: Path) -> list[Recording]:
    """The episode that is asked for, then those of other agents on the same seed."""
    from crowdbench.agent import AgentSpec
    from crowdbench.evaluation.results import scenario_label, slug
    from crowdbench.site.replay import find_recording

    place, _, number = text.rpartition(":")
    name, _, agent = place.partition(":")
    if not (name and agent and number.isdecimal()):
        missing = "there is no such file; " if text.endswith(".gz") else ""
        raise UserError(f"{text!r}: {missing}{_FORMS}")
    seed = int(number)
    is_path = name.endswith((".yaml", ".yml"))
    label = scenario_label(load_scenario(name)) if is_path else name
    wanted = str(AgentSpec.parse(agent))
    folder = results / "trajectories" / slug(label)
    found = []
    for path in sorted(folder.glob("*.jsonl.gz")):
        recording = find_recording(path)
        if recording is not None:
            entries = tuple(entry for entry in recording.entries if entry.seed == seed)
            if entries:
                found.append(replace(recording, entries=entries))
    first = [recording for recording in found if recording.agent == wanted]
    if not first:
        raise UserError(
            f"{results}: no whole episode of {wanted!r} in {label!r} with seed {seed} is stored; "
            f"run it: crowdbench run --scenario {name} --agent {agent} --seed {seed} --episodes 1 "
            f"--save-trajectories --results {results}"
        )
    others = [r for r in found if r.agent != wanted and r.digest == first[0].digest]
    return [*first, *others]
