"""How figures look: one column wide, readable in print and with any colour vision."""

from __future__ import annotations

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


STYLES = {
    "neupan": Style("#009E73", "D", "--"),
    "sac": Style("#56B4E9", "v", ":"),
    "tdmpc": Style("#0072B2", "^", "-."),
    "latent_planner:execute=6": Style("#E69F00", "s", "--"),
    "latent_planner": Style("#D55E00", "o", "-"),
    "orca": Style("#CC79A7", "P", ":"),
    "dynamic_window": Style("#000000", "X", ":"),
    "straight_line": Style("0.6", "", (0, (1, 1))),
    "informed": Style("0.6", "", (0, (5, 2))),
}
"""By agent, in the colours of Okabe and Ito (2008)."""
