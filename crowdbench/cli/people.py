"""``crowdbench people``: what is in a recording of real people."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.common import UserError, err, out
from crowdbench.cli.pictures import save

if TYPE_CHECKING:
    from rich.console import Console

    from crowdbench.people import CrowdRecording

_TOLD_JUMPS = 5
_PARTS = 10
"""Of the table, of a second or more each."""


def people(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording of people.")],
    unit: Annotated[
        str | None,
        typer.Option("--unit", help="Of positions, m, cm or mm, if the file does not say it."),
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option("--fps", help="Frames per second, if the file does not say it."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Picture, by default FILE_tracks.png, here."),
    ] = None,
    save_as: Annotated[
        Path | None,
        typer.Option("--save", metavar="NAME.npz", help="Write the cleaned recording."),
    ] = None,
) -> None:
    """Read a recording of real people, say what is in it and draw all tracks."""
    from crowdbench.people import RecordingError, read_recording

    if save_as is not None and save_as.suffix != ".npz":
        raise UserError(f"--save {save_as}: the name has to end with .npz")
    try:
        recording = read_recording(file, unit, fps)
    except RecordingError as error:
        raise UserError(str(error)) from error
    _print(out(), recording)
    _print_jumps(err(), recording)

    from crowdbench.people.picture import save_picture
    from crowdbench.people.saved import save as save_recording

    # With its suffix, as walk.csv and the walk.npz saved of it lie side by side.
    picture = output or Path(f"{file.name}_tracks.png")
    there = " (in place of an older file)" if picture.exists() else ""
    save(lambda: save_picture(recording, picture), picture)
    out().print(f"picture: {picture}{there}", markup=False, soft_wrap=True)
    if save_as is not None:
        save(lambda: save_recording(recording, save_as), save_as)
        out().print(f"cleaned: {save_as}", markup=False, soft_wrap=True)


def _print(console: Console, recording: CrowdRecording) -> None:
    from rich.table import Table

    from crowdbench.people.summary import most_people, over_time, whole

    (left, low), (right, high) = recording.extent
    known, tracks = len(set(recording.people.tolist())), len(recording.people)
    walls = len(recording.walls)
    for line in (
        f"{recording.name}: {recording.kind}",
        f"people: {known}, at most {most_people(recording)} at a time"
        + (f"; {tracks} tracks" if tracks != known else ""),
        f"duration: {recording.duration:.1f} s, a position every {recording.period:.4g} s, frames "
        f"{recording.frames.min()} to {recording.frames.max()}",
        f"extent: x {left:.2f} to {right:.2f} m, y {low:.2f} to {high:.2f} m; walked on: "
        f"{recording.area:.1f} m²; walls: {f'{walls} closed lines' if walls else 'none known'}",
        f"gaps: {int(recording.interpolated.sum())} positions filled in; tracks begun anew after "
        f"a longer gap: {tracks - known}",
    ):
        console.print(line, markup=False, soft_wrap=True)
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in ("time \\[s]", "people", "density \\[1/m²]", "speed \\[m/s]", "10 to 90 %"):
        table.add_column(heading, justify="right", no_wrap=True)
    count = min(_PARTS, int(recording.duration))
    parts = over_time(recording, count) if count > 1 else []
    for span in (*parts, whole(recording)):
        speeds = [f"{speed:.2f}" for speed in span.speeds if math.isfinite(speed)]
        slow, middle, fast = speeds or "---"
        table.add_row(
            f"{span.begin:.1f} to {span.end:.1f}",
            f"{span.people:.1f}",
            f"{span.density:.2f}",
            middle,
            f"{slow} to {fast}",
        )
    console.print(table)


def _print_jumps(console: Console, recording: CrowdRecording) -> None:
    from crowdbench.people.recording import FASTEST

    jumps = recording.jumps()
    if jumps:
        told = ", ".join(
            f"frame {jump.frame} person {jump.person} ({jump.speed:.1f} m/s)"
            for jump in jumps[:_TOLD_JUMPS]
        )
        more = f" and {len(jumps) - _TOLD_JUMPS} more" if len(jumps) > _TOLD_JUMPS else ""
        console.print(
            f"jumps above {FASTEST:g} m/s from one position to the next: {told}{more}",
            style="yellow",
            markup=False,
            soft_wrap=True,
        )
