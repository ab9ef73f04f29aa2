"""``crowdbench merge``: several results folders into one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from crowdbench.cli.common import RESULTS, err, out


def merge(
    folders: Annotated[list[Path], typer.Argument(help="Results folders, such as shards.")],
    into: Annotated[
        Path, typer.Option("--into", metavar="FOLDER", help="Results folder to add them to.")
    ] = RESULTS,
) -> None:
    """Merge results folders, such as the shards of a run; what is there already stays.

    Folders that disagree in how an episode came out are refused as a whole. Ends with 1 if seeds
    are missing between the first and the last.
    """
    from crowdbench.evaluation.database import FILE
    from crowdbench.evaluation.merge import merge as merge_folders

    merged = merge_folders(folders, into)
    told = f"{into / FILE}: {merged.added:,} episodes added, {merged.there:,} were there"
    if merged.repeated:
        told += f"; {merged.repeated:,} were run twice, of which the times of the first run stay"
    out().print(told, markup=False, soft_wrap=True)
    for line in merged.missing:
        err().print(line, style="yellow", markup=False, soft_wrap=True)
    if merged.missing:
        raise typer.Exit(1)
