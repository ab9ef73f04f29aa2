"""Recorded episodes for the replay viewer: compact, and in files that a page loads one by one.

A page opened from the disk may load scripts but not fetch data, so every file is a script that
hands one object to ``crowdbench.receive``. Long arrays are little-endian float32 in base64: the
log's positions rounded to a ten-millionth, a third of their size as text.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crowdbench.evaluation.episode import Episode
from crowdbench.evaluation.events import find_events
from crowdbench.evaluation.recordings import Recording
from crowdbench.evaluation.results import slug
from crowdbench.simulation.contact import INTENTS

LARGEST_FILE = 4_500_000
"""Bytes of one file of replays; the page promises none above 5 MB."""


def write_replays(recording: Recording, output: Path) -> tuple[list[str], list[dict[str, Any]]]:
    """Write the files of one recording.

    Args:
        recording: what to write.
        output: folder of the page.

    Returns:
        The files, relative to ``output``, and for each episode what lists say of it and the
        number of the file that holds it (None if it is too long for any).
    """
    name = f"data/replays/{slug(recording.cell.scenario)}/{slug(recording.cell.agent)}"
    files: list[str] = []
    waiting: list[str] = []
    listed = []
    for episode in (one for seed in recording.seeds for one in recording.episodes(seed)):
        document = encode(episode)
        text = script_json(document)
        size = sum(map(len, waiting))
        if waiting and size + len(text) > LARGEST_FILE:
            files.append(_write_chunk(output, f"{name}.{len(files)}.js", waiting))
            waiting = []
        fits = len(text) <= LARGEST_FILE
        if fits:
            waiting.append(text)
        listed.append(_line(document, len(files) if fits else None))
    if waiting:
        files.append(_write_chunk(output, f"{name}.{len(files)}.js", waiting))
    return files, listed


def encode(episode: Episode) -> dict[str, Any]:
    """An episode as the viewer reads it."""
    return {
        "seed": episode.seed,
        "robot": episode.robot,
        "outcome": episode.outcome,
        "error": episode.error,
        "period": episode.control_period,
        "steps": episode.steps,
        "footprint": list(episode.footprint),
        "tolerance": episode.goal_tolerance,
        "goal": _numbers(episode.goal),
        "walls": _numbers(episode.walls),
        "obstacles": _numbers(episode.obstacles),
        "radii": _numbers(episode.pedestrian_radius),
        "sees": [_changes(sees) for sees in _sees(episode).T[..., None]],
        "pose": _packed(episode.robot_pose),
        "motion": _packed(_motion(episode)),
        "others": _packed(episode.other_robots),
        "people": episode.pedestrian_position.shape[1],
        "position": _packed(episode.pedestrian_position),
        "velocity": _packed(episode.pedestrian_velocity),
        "goals": [_changes(goal) for goal in episode.pedestrian_goal.transpose(1, 0, 2)],
        "legs": [
            _changes(np.column_stack([intent, time]))
            for intent, time in zip(
                episode.pedestrian_intent.T, episode.pedestrian_switch_time.T, strict=True
            )
        ],
        "intents": list(INTENTS),
        "events": [asdict(event) for event in find_events(episode)],
    }


def script_json(value: Any) -> str:
    """JSON that is safe in a script, whatever text is in it.

    Everything outside ASCII is escaped, U+2028 and U+2029 included, and so is all that could end
    a script element or begin a comment or an entity.
    """
    text = json.dumps(_finite(value), separators=(",", ":"), allow_nan=False)
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def _write_chunk(output: Path, name: str, episodes: Iterable[str]) -> str:
    path = output / name
    path.parent.mkdir(parents=True, exist_ok=True)
    text = f"crowdbench.receive({script_json(name)},[\n" + ",\n".join(episodes) + "\n]);\n"
    path.write_text(text, encoding="ascii")
    return name


def _line(document: dict[str, Any], file: int | None) -> dict[str, Any]:
    kinds = [event["kind"] for event in document["events"]]
    return {
        "seed": document["seed"],
        "robot": document["robot"],
        "outcome": document["outcome"],
        "seconds": round(document["steps"] * document["period"], 6),
        "cutoffs": kinds.count("cutoff"),
        "close": kinds.count("ttc"),
        "file": file,
    }


def _sees(episode: Episode) -> NDArray[np.bool_]:
    """(T + 1, P) who sees the robot: the reactive ones who do not look away."""
    return episode.pedestrian_reactive & episode.pedestrian_attentive


def _motion(episode: Episode) -> NDArray[np.float64]:
    """(T, 2) speed [m/s] and turn rate [rad/s] after each action, whatever the drive."""
    turned = np.diff(episode.robot_pose[:, 2]) / episode.control_period
    return np.column_stack([episode.robot_speed[1:], turned])


def _packed(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


def _changes(values: NDArray[Any]) -> list[list[Any]]:
    """[state, *row] wherever the row differs from the one before."""
    changed = np.any(values[1:] != values[:-1], axis=1)
    states = [0, *(np.flatnonzero(changed) + 1).tolist()]
    return [[state, *_numbers(values[state])] for state in states]


def _numbers(values: NDArray[Any]) -> Any:
    """Nested lists with the precision of ``_packed``."""
    return np.asarray(values, dtype=np.float32).astype(float).round(6).tolist()


def _finite(value: Any) -> Any:
    """The same with null for numbers that JSON cannot say."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
