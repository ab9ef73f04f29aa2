"""``crowdbench record``: an episode as a video."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from crowdbench.cli.common import DEFAULT_AGENT, AgentOption, SetOption, UserError, out
from crowdbench.cli.pictures import ScenarioArgument, SeedOption, picture, save
from crowdbench.scenario import load_scenario, parse_overrides

VIDEO_SUFFIXES = (".gif", ".mp4")


def record(
    scenario: ScenarioArgument,
    agent: AgentOption = DEFAULT_AGENT,
    seed: SeedOption = 0,
    overrides: SetOption = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help=".gif or .mp4, by default SCENARIO-AGENT-SEED.gif."),
    ] = None,
) -> None:
    """Record one episode as a GIF or MP4."""
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
    episodes = run_episode(env, spec, seed, on_step=lambda env: frames.append(picture(env)))
    save(lambda: write_video(frames, path, fps=1 / world.control_period), path)
    console = out()
    for episode in episodes:
        seconds = episode.steps * world.control_period
        told = f"{episode.robot}: {episode.outcome} after {seconds:.1f} s"
        console.print(told + (f": {episode.error}" if episode.error else ""), markup=False)
    console.print(f"{path}: {world.name}, {spec}, seed {seed}", markup=False)
