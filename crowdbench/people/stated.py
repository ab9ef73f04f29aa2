"""Unit and frame rate: said by the file or by the user, and never guessed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

from crowdbench.people.errors import RecordingError

_SAME = 0.01
"""Share by which two frame rates may differ and still are the same."""


class Stated(NamedTuple):
    """What somebody says of a recording; None where they do not.

    Attributes:
        unit: of positions, one of ``UNITS``.
        fps: frames per second.
    """

    unit: str | None
    fps: float | None


def settle(path: Path, said: Stated, given: Stated, fps_too: tuple[float, ...] = ()) -> Stated:
    """The file's words, or the user's where it has none; neither is None.

    Args:
        path: of the file.
        said: by the file.
        given: by the user.
        fps_too: other frame rates that the user may say for the file's.

    Raises:
        RecordingError: they disagree, something is said by nobody, or the file's rate cannot be.
    """
    if said.fps is not None and not (math.isfinite(said.fps) and said.fps > 0):
        raise RecordingError(f"{path}: its frame rate is {said.fps:g}, and has to be above 0")
    if None not in (said.unit, given.unit) and said.unit != given.unit:
        raise RecordingError(
            f"{path}: it has positions in {said.unit}, and {given.unit} is given; correct what is "
            "wrong, the file or unit"
        )
    rates = () if said.fps is None else (said.fps, *fps_too)
    if given.fps is not None and rates and not any(_same(given.fps, rate) for rate in rates):
        raise RecordingError(
            f"{path}: it has {' or '.join(f'{rate:g}' for rate in rates)} frames a second, and "
            f"{given.fps:g} is given; correct what is wrong, the file or fps"
        )
    unit, fps = said.unit or given.unit, said.fps or given.fps
    questions = [
        *(["in which unit its positions are (unit: m, cm or mm)"] if unit is None else []),
        *(["how many frames a second it has (fps: e.g. 25)"] if fps is None else []),
    ]
    if questions:
        raise RecordingError(f"{path}: does not say {', nor '.join(questions)}; please do")
    return Stated(unit, fps)


def _same(one: float, other: float) -> bool:
    return abs(one / other - 1) < _SAME
