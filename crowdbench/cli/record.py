"""``crowdbench record``: an episode as a video."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.common import (
    DEFAULT_AGENT,
    RESULTS,
    AgentOption,
    ResultsOption,
    SetOption,
    UserError,
    out,
)
from crowdbench.cli.pictures import ScenarioArgument, SeedOption, picture, save
from crowdbench.scenario import load_scenario, parse_overrides

if TYPE_CHECKING:
    from crowdbench.agent import AgentSpec
    from crowdbench.evaluation.recordings import Recording
    from crowdbench.scenario import Scenario
    from crowdbench.simulation.env import CrowdEnv

VIDEO_SUFFIXES = (".gif", ".mp4")


def record(
    scenario: ScenarioArgument,
    agent: AgentOption = DEFAULT_AGENT,
    seed: SeedOption = 0,
    overrides: SetOption = None,
    results: ResultsOption = RESULTS,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help=".gif or .mp4, by default SCENARIO-AGENT-SEED.gif."),
    ] = None,
) -> None:
    """Record one episode as a GIF or MP4; one that is stored or published runs no agent."""
    world = load_scenario(scenario, **parse_overrides(overrides or []))

    from crowdbench.agent import AgentSpec
    from crowdbench.evaluation.results import slug
    from crowdbench.evaluation.rollout import run_episode
    from crowdbench.simulation.env import CrowdEnv
    from crowdbench.simulation.video import CompressedFrames, write_video

    spec = AgentSpec.parse(agent)
    path = output or Path(f"{world.name}-{slug(str(spec))}-{seed}.gif")
    if path.suffix.lower() not in VIDEO_SUFFIXES:
        raise UserError(f"{path}: expected a name that ends in {' or '.join(VIDEO_SUFFIXES)}")
    env = CrowdEnv(world, render_mode="rgb_array")
    frames = CompressedFrames()
    stored = _stored(results, world, spec, seed)

    def draw(env: CrowdEnv) -> None:
        frames.append(picture(env))

    if stored:
        episodes = stored.episodes(seed, env, on_step=draw)
    else:
        episodes = run_episode(env, spec, seed, on_step=draw)
    save(lambda: write_video(frames, path, fps=1 / world.control_period), path)
    console = out()
    for episode in episodes:
        seconds = episode.steps * world.control_period
        told = f"{episode.robot}: {episode.outcome} after {seconds:.1f} s"
        console.print(told + (f": {episode.error}" if episode.error else ""), markup=False)
    told = ""
    if stored:
        told = f" (no agent was run: {stored.sources[seed]})"
    console.print(f"{path}: {world.name}, {spec}, seed {seed}{told}", markup=False, soft_wrap=True)


def _stored(results: Path, world: Scenario, spec: AgentSpec, seed: int) -> Recording | None:
    """The episode, if it was run before; not if the agent's file has been changed since."""
    from crowdbench.agent import code_version
    from crowdbench.evaluation.joined import published_and_local
    from crowdbench.evaluation.recordings import find_recordings
    from crowdbench.evaluation.results import scenario_label

    rows = published_and_local(results, scenario_label(world), str(spec), first="local")
    if ".py:" in spec.name:
        rows = rows[rows["code"] == code_version(spec.name)]
    found = find_recordings(rows[rows["seed"] == seed])
    return found[0] if found else None
