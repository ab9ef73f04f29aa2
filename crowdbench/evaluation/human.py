"""A person drives the robot: a window, the keyboard, and an episode stored like any other."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from crowdbench.agent import Action, Agent
from crowdbench.evaluation.database import require_writable
from crowdbench.evaluation.driven import Driven
from crowdbench.evaluation.episode import Episode
from crowdbench.evaluation.machine import machine_name
from crowdbench.evaluation.results import Cell, Origin, ResultsStore, scenario_label
from crowdbench.evaluation.scoring import Scorer
from crowdbench.robot import Observation, RobotSpec
from crowdbench.scenario import Scenario
from crowdbench.simulation import WORLD_VERSION
from crowdbench.simulation import window as windows

if TYPE_CHECKING:
    import pygame

    from crowdbench.simulation.env import CrowdEnv

HUMAN = "human"
"""The name under which a person's episodes are stored."""

_FRAMES = 60  # per second, at which keys and the window are looked after
_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")


class NoDisplayError(RuntimeError):
    """There is no screen to drive on; the message says what is needed."""


class QuitError(Exception):
    """The person has left before the episode ended."""


class Driver(Agent):
    """Turns the keys that are held into an action: full speed, or half with shift."""

    def __init__(self) -> None:
        self._held: set[str] = set()
        self._robot: RobotSpec | None = None

    def reset(self, robot: RobotSpec, seed: int) -> None:
        """Take note of the robot's limits."""
        self._robot = robot

    def hold(self, keys: Iterable[str]) -> None:
        """Take note of the keys that are down: up, down, left, right, slow."""
        self._held = set(keys)

    def act(self, observation: Observation) -> Action:
        """Forward or back with up and down, turning with left and right."""
        assert self._robot is not None, "reset() comes first"
        ahead = ("up" in self._held) - ("down" in self._held)
        left = ("left" in self._held) - ("right" in self._held)
        share = 0.5 if "slow" in self._held else 1.0
        lowest, highest = self._robot.speed
        v = highest if ahead > 0 else min(lowest, 0.0) if ahead < 0 else 0.0
        slowest, fastest = self._robot.turn_rate
        w = fastest if left > 0 else slowest if left < 0 else 0.0
        return share * v, share * w


class Window(windows.Window):
    """Shows the scene at real-time pace and hands the keys to a driver; one at a time."""

    _latest: ClassVar[Window | None] = None

    def __init__(self, title: str, size: tuple[int, int], driver: Driver) -> None:
        """Open a window with the given inner size [px].

        Raises:
            NoDisplayError: there is no screen, or somebody drives in this process already.
        """
        if Window._latest is not None and not Window._latest.closed:
            raise NoDisplayError("somebody drives in this process already; end that drive first")
        if sys.platform.startswith("linux") and not any(map(os.environ.get, _SCREENS)):
            raise NoDisplayError(
                "a window needs a display, and there is none (neither DISPLAY nor WAYLAND_DISPLAY "
                "is set); run this on a desktop, or connect with ssh -X"
            )
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        import pygame

        try:
            super().__init__(pygame, title, size)
        except pygame.error as error:
            raise NoDisplayError(f"a window needs a display: {error}") from error
        Window._latest, self._driver = self, driver
        self._clock = pygame.time.Clock()
        self._down: set[int] = set()
        self._keys = {
            pygame.K_UP: "up", pygame.K_w: "up", pygame.K_DOWN: "down", pygame.K_s: "down",
            pygame.K_LEFT: "left", pygame.K_a: "left", pygame.K_RIGHT: "right",
            pygame.K_d: "right", pygame.K_LSHIFT: "slow", pygame.K_RSHIFT: "slow",
        }  # fmt: skip

    def show(self, picture: pygame.Surface) -> None:
        """Replace what is shown; events are for ``wait``.

        Raises:
            QuitError: the window was closed.
        """
        if self.closed:
            raise QuitError
        self._window.get_surface().blit(picture, (0, 0))
        self._window.flip()

    def wait(self, seconds: float) -> None:
        """Look after the keys for a while.

        Raises:
            QuitError: Escape, or the window was closed.
        """
        end = time.monotonic() + seconds
        while True:
            self._read_events()
            if time.monotonic() >= end:
                return
            self._clock.tick(_FRAMES)

    def wait_for_a_key(self) -> None:
        """Look after the keys until one that steers is held; raises as ``wait``."""
        while not self._down:
            self.wait(1 / _FRAMES)

    def _read_events(self) -> None:
        if self.closed:
            raise QuitError
        pygame = self._pygame
        for event in pygame.event.get():
            if event.type == pygame.QUIT:
                raise QuitError
            if getattr(event, "window", None) not in (None, self._window):
                continue  # another window's
            if event.type == pygame.WINDOWCLOSE:
                raise QuitError
            if event.type == pygame.KEYDOWN and event.key == pygame.K_ESCAPE:
                raise QuitError
            if event.type == pygame.KEYDOWN and event.key in self._keys:
                self._down.add(event.key)
            elif event.type == pygame.KEYUP:
                self._down.discard(event.key)
            elif event.type == pygame.WINDOWFOCUSLOST:
                self._down.clear()  # their release goes to another window
        self._driver.hold(self._keys[key] for key in self._down)


def drive(scenario: Scenario, seed: int) -> Episode:
    """Let a person drive one episode of a scenario with one robot.

    It begins when a key that steers is pressed and goes on at real-time pace.

    Raises:
        NoDisplayError: there is no screen, or somebody drives in this process already.
        QuitError: the person has left; nothing is left open.
        ScenarioError: the scenario has no room.
    """
    driver = Driver()
    title = f"crowdbench: {scenario.name}, seed {seed}: arrow keys drive, shift slows, Esc ends"
    from crowdbench.evaluation.rollout import run_episode
    from crowdbench.simulation.env import CrowdEnv

    env = CrowdEnv(scenario, render_mode="rgb_array")
    window: Window | None = None
    due = 0.0

    def on_step(env: CrowdEnv) -> None:
        nonlocal window, due
        picture = env.render()
        assert picture is not None
        first = window is None
        window = window or Window(title, picture.shape[1::-1], driver)
        window.show(_surface(picture))
        if first:
            window.wait_for_a_key()
            due = time.monotonic()
        else:
            # What drawing takes is part of the period; a machine that is late does not hurry.
            due = max(due + scenario.control_period, time.monotonic())
            window.wait(due - time.monotonic())

    try:
        (episode,) = run_episode(env, [driver], seed, label=HUMAN, on_step=on_step)
    finally:
        if window is not None:
            window.close()
        env.close()
    return episode


def _surface(picture: NDArray[np.uint8]) -> pygame.Surface:
    """A picture (height, width, 3) as pygame has it."""
    import pygame

    return pygame.surfarray.make_surface(picture.transpose(1, 0, 2))


def human_cell(scenario: Scenario) -> Cell:
    """Under which a person's episodes in a scenario are stored."""
    return Cell(
        scenario=scenario_label(scenario),
        scenario_digest=scenario.digest,
        agent=HUMAN,
        options="{}",
        world=WORLD_VERSION,
        weights_sha256="",
        code="keyboard",
    )


def next_seed(scenario: Scenario, folder: Path) -> int:
    """The first seed of a scenario that nobody has driven yet."""
    stored = ResultsStore(folder).stored(human_cell(scenario))
    return next(seed for seed in range(len(stored) + 1) if seed not in stored)


def store_drive(scenario: Scenario, episode: Episode, folder: Path) -> Path:
    """Store a person's episode; returns the file it is in.

    Raises:
        ResultsError: the folder cannot be written to.
    """
    require_writable(folder)
    cell, store = human_cell(scenario), ResultsStore(folder)
    driven = [Driven.of(episode)]
    origin = Origin.of(machine_name()).now()
    results = Scorer().score(scenario, HUMAN, episode.seed, driven, origin)
    store.append(cell, results, scenario)
    return store.path
