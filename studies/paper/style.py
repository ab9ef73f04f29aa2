"""The colours, markers and lines of the paper's methods."""

from crowdbench.study.style import Style

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
