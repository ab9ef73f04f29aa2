"""Studies: what is compared, where, and what is claimed; from stored episodes to tables and pages.

A study is one file that defines one ``Study``; ``crowdbench tables my_study.py`` takes it from
there. Installed packages add studies through the entry-point group ``crowdbench.studies``.
"""

from crowdbench.study.model import (
    EPISODES,
    Block,
    Cell,
    Claim,
    Drawing,
    Method,
    Quantity,
    Study,
    StudyError,
    Table,
)

__all__ = [
    "EPISODES",
    "Block",
    "Cell",
    "Claim",
    "Drawing",
    "Method",
    "Quantity",
    "Study",
    "StudyError",
    "Table",
]
