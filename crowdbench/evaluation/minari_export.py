"""Stored episodes of one robot as a data set of Minari, for offline reinforcement learning.

Nothing of what was observed or rewarded is stored: seed and commands are, and the rest is simulated
again.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from minari import MinariDataset, create_dataset_from_buffers
from minari.data_collector import EpisodeBuffer

from crowdbench.evaluation.recordings import Recording
from crowdbench.evaluation.results import ResultsError
from crowdbench.scenario import Scenario, load_scenario, scenario_names

if TYPE_CHECKING:
    from crowdbench.evaluation.driven import Driven


def write_dataset(recording: Recording, name: str) -> MinariDataset:
    """Write all episodes of a recording that have steps.

    Observations, rewards and ends are those of ``CrowdNavEnv``, actions (T, 2) what the robot was
    asked for, within its limits. An episode that an agent's error has ended is truncated there.
    Each has its ``seed`` and its ``outcome`` as metadata.

    Args:
        recording: of one robot.
        name: of the data set, ``[NAMESPACE/]NAME-vNUMBER``.

    Returns:
        The data set, in Minari's folder.

    Raises:
        ScenarioError: more robots than one, or pedestrians that are agents.
        ResultsError: commands cannot be read, or are not those of an episode.
        ValueError: a name that is none or is taken.
    """
    cell, env = recording.cell, make_environment(recording.scenario)
    buffers, outcomes = [], []
    for seed in recording.seeds:
        (driven,) = recording.load(seed)
        if len(driven.commands):
            buffers.append(_simulated(env, seed, driven, where=recording.sources[seed]))
            outcomes.append({"outcome": driven.outcome})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of authors and links that nobody has given
        dataset = create_dataset_from_buffers(
            name,
            buffers,
            env=env,
            algorithm_name=cell.agent,
            description=f"{cell.agent} in crowdbench's scenario {cell.scenario}",
        )
    dataset.storage.update_episode_metadata(outcomes)
    return dataset


def make_environment(scenario: Scenario) -> gymnasium.Env[Any, Any]:
    """The Gymnasium environment of a scenario, which its ``spec`` describes wherever it is read.

    Raises:
        ScenarioError: more robots than one, or pedestrians that are agents.
    """
    own = scenario_names()
    arguments: dict[str, Any] = {"scenario": scenario.name}
    if scenario.name not in own or load_scenario(scenario.name) != scenario:
        # Every field replaced, whichever scenario that is done to.
        arguments = {"scenario": own[0], **scenario.model_dump(mode="json")}
    return gymnasium.make("crowdbench:CrowdNav-v0", disable_env_checker=True, **arguments)


def _simulated(
    env: gymnasium.Env[Any, Any], seed: int, driven: Driven, where: str
) -> EpisodeBuffer:
    space = env.action_space
    assert isinstance(space, gymnasium.spaces.Box)
    seen, _ = env.reset(seed=seed)
    observations, rewards, terminations, truncations = [seen], [], [], []
    outcome = "running"
    for command in driven.commands:
        if outcome != "running":
            break
        seen, reward, terminated, truncated, info = env.step(command)
        observations.append(seen)
        rewards.append(float(reward))
        terminations.append(terminated)
        truncations.append(truncated)
        outcome = info["outcome"]
    expected = "running" if driven.outcome == "agent_error" else driven.outcome
    if (outcome, len(rewards)) != (expected, len(driven.commands)):
        raise ResultsError(
            f"{where}: seed {seed}: said to end with {driven.outcome} after {len(driven.commands)} "
            f"steps, but is {outcome} after {len(rewards)}"
        )
    truncations[-1] |= driven.outcome == "agent_error"
    return EpisodeBuffer(
        seed=seed,
        observations={key: np.stack([one[key] for one in observations]) for key in seen},
        actions=np.clip(driven.commands.astype(np.float32), space.low, space.high),
        rewards=rewards,
        terminations=terminations,
        truncations=truncations,
    )
