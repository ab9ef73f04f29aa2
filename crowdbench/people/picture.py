"""All tracks of a recording in one picture, with its walls."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from crowdbench.people.recording import CrowdRecording, IntArray
from crowdbench.replacing import replacing

_SIZE = 7.0
"""Of the longer side of what is drawn [in]."""
_LOOK: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
_DIRECTIONS = (("to the right", "#0072B2"), ("up", "#E69F00"), ("to the left", "#D55E00"),
               ("down", "#009E73"))  # fmt: skip
"""From a track's beginning to its end, by quarters of the circle; colours of Okabe and Ito."""


def directions(recording: CrowdRecording) -> IntArray:
    """Where each track leads, (T,): 0 right (+x), 1 up (+y), 2 left, 3 down."""
    first, last = recording.starts[:-1], recording.starts[1:] - 1
    x, y = (recording.positions[last] - recording.positions[first]).T
    return np.rint(np.arctan2(y, x) / (np.pi / 2)).astype(np.int64) % 4


def draw(recording: CrowdRecording) -> Figure:
    """Tracks as lines, by the direction in which they lead, with a dot where each begins."""
    drawn = np.concatenate([recording.positions, *recording.walls])
    size = np.maximum(np.ptp(drawn, axis=0), 1.0)
    width, height = np.maximum(size / size.max(), 0.2) * _SIZE
    with mpl.rc_context(_LOOK):
        figure = Figure(figsize=(max(width, 3.5) + 0.8, height + 1.2), layout="constrained")
        axes = figure.subplots()
        for wall in recording.walls:
            axes.plot(*wall.T, color="black", linewidth=1.5, zorder=3)
        tracks = np.split(recording.positions, recording.starts[1:-1])
        leads = directions(recording)
        fade = float(np.clip(50 / len(tracks), 0.2, 0.8))
        handles = [Line2D([], [], color="0.3", marker=".", linestyle="", label="where one begins")]
        for number, (name, color) in enumerate(_DIRECTIONS):
            chosen = np.flatnonzero(leads == number)
            if len(chosen):
                paths = [tracks[n] for n in chosen]
                axes.add_collection(LineCollection(paths, colors=color, linewidths=0.8, alpha=fade))
                axes.plot(*np.array([path[0] for path in paths]).T, ".", color=color, markersize=4)
                handles.append(Line2D([], [], color=color, label=f"{name} ({len(chosen)})"))
        axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
        axes.set_title(recording.name, parse_math=False)
        axes.autoscale_view()
        columns = 5 if width > 5 else 2
        figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False)
    return figure


def save_picture(recording: CrowdRecording, path: Path) -> None:
    """Draw a recording into a file of a kind that matplotlib knows by its name.

    Raises:
        OSError: it cannot be written.
        ValueError: the kind is not known.
    """
    # Straight to a file, Pillow does not notice that there is no room for a JPEG.
    content = io.BytesIO()
    kind = path.suffix[1:] or None
    draw(recording).savefig(content, format=kind, dpi=150, bbox_inches="tight")
    with replacing(path) as part:
        part.write_bytes(content.getvalue())
