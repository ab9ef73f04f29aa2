"""How figures get onto the disk."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

from crowdbench.replacing import replacing
from crowdbench.study.measurements import Measurements
from crowdbench.study.model import Drawing
from crowdbench.study.style import LOOK


def save_figures(
    drawings: Sequence[Drawing], measured: Measurements, source: Path, target: Path
) -> dict[str, bool]:
    """Draw every figure that has data, as PDF and PNG, the same bytes for the same data.

    Args:
        drawings: of a study.
        measured: the stored episodes.
        source: results folder with training curves and trajectories.
        target: folder of the files; a figure without data is removed from it.

    Returns:
        For each name whether there is a figure.
    """
    if drawings:
        target.mkdir(parents=True, exist_ok=True)
    there = {}
    for drawing in drawings:
        with mpl.rc_context(LOOK):
            figure = drawing.draw(measured, source)
            there[drawing.name] = figure is not None
            pdf, png = (target / f"{drawing.name}.{ending}" for ending in ("pdf", "png"))
            if figure is None:
                pdf.unlink(missing_ok=True)
                png.unlink(missing_ok=True)
            else:
                with replacing(pdf) as part:
                    figure.savefig(part, metadata={"CreationDate": None, "Producer": None})
                with replacing(png) as part:
                    figure.savefig(part, metadata={"Software": None})
    return there
