"""Finding a study by name or in a file, and checking it before anything runs."""

from __future__ import annotations

import re
import runpy
from collections.abc import Sequence
from importlib.metadata import entry_points
from pathlib import Path

from crowdbench.agent import AgentError, AgentSpec, agent_names, find_agent
from crowdbench.evaluation.metrics import METRICS
from crowdbench.messages import describe_error, nearest, short
from crowdbench.registry import Registry, UnknownNameError
from crowdbench.scenario import ScenarioError, load_scenario
from crowdbench.study.model import (
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

GROUP = "crowdbench.studies"
"""Of entry points."""
STUDIES: Registry[Study] = Registry("study", GROUP, {}, of=Study)
"""Installed studies by name."""

_NAME = re.compile(r"[A-Za-z0-9_-]+")


def load_study(text: str) -> Study:
    """An installed study, or the one that a file defines.

    Args:
        text: name, or path of a ``.py`` file.

    Raises:
        StudyError: there is none, or it names an agent, a scenario or a metric that is not known.
    """
    try:
        study = _from_file(Path(text)) if text.endswith(".py") else STUDIES[text]
    except UnknownNameError as error:
        raise StudyError(f"{error}; or give a file: my_study.py") from error
    where = text if text.endswith(".py") else f"study {text!r}"
    try:
        check_study(study)
    except (StudyError, AgentError, ScenarioError) as error:
        raise StudyError(f"{where}: {error}") from error
    return study


def is_shipped(text: str) -> bool:
    """Whether what ``load_study`` takes names a study that comes with crowdbench."""
    return any(
        point.name == text and point.value.startswith("crowdbench_studies.")
        for point in entry_points(group=GROUP)
    )


def check_study(study: Study) -> None:
    """Make sure that everything a study names is there.

    Raises:
        StudyError, AgentError, ScenarioError: the first thing that is not.
    """
    _check_kinds(study)
    _check_names(study)
    cells = study.cells()
    for agent in dict.fromkeys(cell.agent for cell in cells):
        _check_agent(AgentSpec.parse(agent).name)
    for scenario in dict.fromkeys(cell.scenario for cell in cells):
        load_scenario(scenario)
    for cell in cells:
        if not isinstance(cell.episodes, int) or cell.episodes < 1:
            raise StudyError(
                f"agent {cell.agent!r}: episodes is {cell.episodes!r}, expected 1 or more"
            )
    quantities = [quantity.metric for table in study.tables for quantity in table.quantities]
    for metric in (*quantities, *(claim.metric for claim in study.claims)):
        if metric not in METRICS:
            raise StudyError(f"unknown metric {metric!r}{nearest(metric, list(METRICS))}")
    _check_claims(study, cells)


def _check_claims(study: Study, cells: Sequence[Cell]) -> None:
    numbers = [table.number for table in study.tables]
    run = {(cell.agent, cell.scenario) for cell in cells}
    for claim in study.claims:
        if claim.table not in numbers:
            raise StudyError(
                f"claim {claim.text!r}: no table {claim.table!r}{nearest(claim.table, numbers)}"
            )
        for agent in (claim.better, claim.worse):
            for scenario in claim.scenarios:
                if (agent, scenario) not in run:
                    raise StudyError(
                        f"claim {claim.text!r}: no table has agent {agent!r} in scenario "
                        f"{scenario!r}"
                    )


def _check_kinds(study: Study) -> None:
    """A forgotten comma makes no tuple, which would be told late and badly."""
    fields: list[tuple[str, object, type]] = [
        ("tables", study.tables, Table),
        ("claims", study.claims, Claim),
        ("figures", study.figures, Drawing),
        ("more", study.more, Cell),
        ("shown", study.shown, str),
    ]
    for name, value, kind in fields:
        _check_tuple(name, value, kind)
    for table in study.tables:
        where = f"table {table.number!r}, "
        _check_tuple(where + "blocks", table.blocks, Block)
        _check_tuple(where + "quantities", table.quantities, Quantity)
        _check_tuple(where + "methods", table.methods, Method)
        for block in table.blocks:
            _check_tuple(where + "scenarios of a block", block.scenarios, str)
    for claim in study.claims:
        _check_tuple(f"claim {claim.text!r}, scenarios", claim.scenarios, str)


def _check_tuple(name: str, value: object, kind: type) -> None:
    if type(value) is not tuple or not all(isinstance(item, kind) for item in value):
        got = short(value)
        raise StudyError(f"{name}: expected a tuple of {kind.__name__}, got {got}")


def _check_names(study: Study) -> None:
    numbers = [table.number for table in study.tables]
    drawings = [drawing.name for drawing in study.figures]
    for kind, names in (("name", [study.name]), ("table", numbers), ("figure", drawings)):
        for name in names:
            if not _NAME.fullmatch(name):
                raise StudyError(f"{kind} {name!r}: expected letters, digits, - and _")
            if names.count(name) > 1:
                raise StudyError(f"{kind} {name!r} is there twice")
    for table in study.tables:
        labels = [method.label for method in table.methods]
        for label in labels:
            if labels.count(label) > 1:
                raise StudyError(f"table {table.number!r}: two methods have the label {label!r}")
        places = {
            (block.heading, label, quantity.metric)
            for block in table.blocks
            for label in labels
            for quantity in table.quantities
        }
        for key in table.reference:
            if key not in places:
                raise StudyError(
                    f"table {table.number!r}, reference {key!r}: no such cell; expected block "
                    "heading, method label and metric"
                )
    for name in study.shown:
        if name not in (*numbers, *drawings):
            known = nearest(name, [*numbers, *drawings])
            raise StudyError(f"shown {name!r}: no such table or figure{known}")


def _check_agent(name: str) -> None:
    """Files are read; installed agents, which may take seconds to load, are found by name only."""
    if name.partition(":")[0].endswith(".py"):
        find_agent(name)
    elif name not in agent_names():
        raise StudyError(f"unknown agent {name!r}{nearest(name, agent_names())}")


def _from_file(path: Path) -> Study:
    if not path.is_file():
        raise StudyError(f"study file {str(path)!r} does not exist")
    try:
        names = runpy.run_path(str(path), run_name=f"crowdbench_study_{path.stem}")
    except (Exception, SystemExit) as error:
        raise StudyError(f"study file {str(path)!r}: {describe_error(error)}") from error
    found = {id(value): (name, value) for name, value in names.items() if isinstance(value, Study)}
    if len(found) != 1:
        told = ", ".join(name for name, _ in found.values()) or "none"
        raise StudyError(f"study file {str(path)!r}: expected one Study, found {told}")
    ((_, study),) = found.values()
    return study
