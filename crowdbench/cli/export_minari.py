"""``crowdbench export-minari``: stored episodes as a data set to learn from."""

from __future__ import annotations

import importlib.util
import re
from typing import Annotated

import typer

from crowdbench.agent import AgentSpec
from crowdbench.cli.common import (
    DEFAULT_AGENT,
    RESULTS,
    AgentOption,
    ResultsOption,
    SetOption,
    UserError,
    err,
    out,
)
from crowdbench.cli.pictures import ScenarioArgument
from crowdbench.scenario import load_scenario, parse_overrides

FIRST_TRAINING_SEED = 1_000
"""Episodes with lower seeds are those that agents are compared on."""


def export_minari(
    scenario: ScenarioArgument,
    name: Annotated[str, typer.Argument(help="Of the data set: [NAMESPACE/]NAME-vNUMBER.")],
    agent: AgentOption = DEFAULT_AGENT,
    overrides: SetOption = None,
    results: ResultsOption = RESULTS,
) -> None:
    """Write the stored episodes of an agent in a scenario as a Minari data set."""
    world = load_scenario(scenario, **parse_overrides(overrides or []))
    spec = AgentSpec.parse(agent)
    if not re.fullmatch(r"([-\w]{2,}/)*[-\w]+-v\d+", name):
        raise UserError(f"data set {name!r}: expected [NAMESPACE/]NAME-vNUMBER, e.g. crowd/mine-v0")
    if any(importlib.util.find_spec(library) is None for library in ("minari", "h5py")):
        raise UserError("Minari is not installed: pip install 'crowdbench-nav[minari]'")

    from crowdbench.evaluation.joined import local_rows
    from crowdbench.evaluation.minari_export import write_dataset
    from crowdbench.evaluation.recordings import find_recordings
    from crowdbench.evaluation.results import scenario_label

    rows = local_rows(results, scenario_label(world), str(spec))
    recordings = find_recordings(rows)
    if not recordings:
        raise UserError(
            f"{results}: no episodes of {spec} in {scenario_label(world)} are stored here with "
            "what the robot did; crowdbench run stores some"
        )
    try:
        dataset = write_dataset(recordings[0], name)
    except (ValueError, OSError) as error:
        raise UserError(f"data set {name!r}: {error}") from error
    compared = sum(seed < FIRST_TRAINING_SEED for seed in recordings[0].seeds)
    if compared:
        err().print(
            f"{compared} of these episodes have seeds below {FIRST_TRAINING_SEED:,}, on which "
            "agents are compared: what learns from them cannot be",
            style="yellow",
            markup=False,
            soft_wrap=True,
        )
    told = f"{dataset.total_episodes} episodes, {dataset.total_steps:,} steps"
    out().print(f"{name}: {told} ({dataset.spec.data_path})", markup=False, soft_wrap=True)
