"""What a run and its worker processes say to each other."""

from __future__ import annotations

from dataclasses import dataclass

from crowdbench.agent import AgentError, AgentSpec
from crowdbench.evaluation.driven import Driven
from crowdbench.evaluation.results import Cell
from crowdbench.scenario import Scenario, ScenarioError

MOST_WARNINGS = 20
"""Of an agent in a run that are shown, and of an episode that are sent."""


@dataclass(frozen=True)
class Describe:
    """Make the agent and say which one it is."""

    agent: AgentSpec


@dataclass(frozen=True)
class Job:
    """Run one episode."""

    scenario: Scenario
    agent: AgentSpec
    cell: Cell
    seed: int


@dataclass(frozen=True)
class Described:
    """Answer to Describe: what distinguishes this agent from another of the same name."""

    weights_sha256: str
    code: str
    drives: tuple[str, ...] | None
    unsupported_models: tuple[str, ...] = ()


@dataclass(frozen=True)
class Done:
    """Answer to Job: what each robot did, which the parent simulates again to measure it.

    Attributes:
        driven: of each robot.
        warned: warnings since the last answer, each in one line.
    """

    driven: list[Driven]
    warned: tuple[str, ...] = ()


@dataclass(frozen=True)
class Refused:
    """Answer to either: the user's mistake."""

    error: AgentError | ScenarioError


@dataclass(frozen=True)
class Broken:
    """Answer to either: what failed outside the agent's calls, with the traceback."""

    traceback: str


@dataclass(frozen=True)
class Lost:
    """What became of a message whose process hung or ended.

    Attributes:
        reason: in one line.
        outside: the process was killed from outside, which is not the agent's fault.
    """

    reason: str
    outside: bool = False


Message = Describe | Job
Answer = Described | Done | Refused | Broken
