"""How figures look: one column wide, readable in print and with any colour vision."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import count
from typing import Any, NamedTuple

WIDTH = 3.5
"""Of one column [in]."""

LOOK: Any = {
    "font.size": 8,
    "axes.titlesize": 8,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "legend.handlelength": 2.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.2,
    "lines.markersize": 4,
    "pdf.fonttype": 42,  # letters stay letters
    "savefig.dpi": 300,
}
"""Settings of matplotlib."""


class Style(NamedTuple):
    """How a method is drawn; what a colour says, marker and line say too."""

    color: str
    marker: str
    line: Any


_COLORS = ("#D55E00", "#0072B2", "#009E73", "#E69F00", "#56B4E9", "#CC79A7", "#000000")
"""Of Okabe and Ito (2008)."""
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*", "<", ">", "p")
_LINES = ("-", "--", "-.", ":")


def styles(agents: Iterable[str], chosen: Mapping[str, Style] | None = None) -> dict[str, Style]:
    """A style for each agent: the chosen one, or the first that no other one resembles.

    Args:
        agents: with their options.
        chosen: by agent; others may be missing.
    """
    found = dict(chosen or {})
    free = (
        Style(_COLORS[n % len(_COLORS)], _MARKERS[n % len(_MARKERS)], _LINES[n % len(_LINES)])
        for n in count()
    )
    result = {}
    for agent in agents:
        if agent not in found:
            used = {(style.color, style.marker) for style in found.values()}
            found[agent] = next(s for s in free if (s.color, s.marker) not in used)
        result[agent] = found[agent]
    return result
