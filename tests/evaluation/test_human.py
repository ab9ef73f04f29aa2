"""A person's drive, with the keys pressed by the test: pygame's dummy driver has no screen."""

from __future__ import annotations

import numpy as np
import pygame
import pytest

from crowdbench.evaluation import human
from crowdbench.evaluation.results import ResultsError, load_results
from crowdbench.evaluation.stored import find_cells, load_episodes
from crowdbench.robot import Observation, RobotSpec
from crowdbench.scenario import load_scenario
from crowdbench.simulation.env import CrowdEnv

SCENARIO = load_scenario(
    "multimodal_fast", time_limit=1.0, control_period=0.05, pedestrians={"count": 0}
)


@pytest.fixture
def press(monkeypatch):
    """Press keys as soon as the window shows its first picture."""

    def press(*events):
        waits = human.Window.wait_for_a_key

        def shown(self):
            for kind, key in events:
                pygame.event.post(pygame.event.Event(kind, {"key": key} if key else {}))
            waits(self)

        monkeypatch.setattr(human.Window, "wait_for_a_key", shown)

    return press


@pytest.mark.parametrize(
    ("keys", "action"),
    [
        ([], (0, 0)),
        (["up"], (1, 0)),
        (["up", "left"], (1, 1.5)),
        (["right"], (0, -1.5)),
        (["left", "right"], (0, 0)),
        (["down"], (0, 0)),
        (["up", "right", "slow"], (0.5, -0.75)),
    ],
)
def test_keys_are_speeds_within_the_robots_limits(keys, action):
    driver = human.Driver()
    driver.reset(RobotSpec.from_scenario(SCENARIO), seed=0)
    driver.hold(keys)
    assert driver.act(Observation(*[np.zeros(3)] * 4)) == action


def test_a_robot_that_can_goes_backwards():
    world = SCENARIO.override({"robots.speed": [-0.4, 1.0]})
    driver = human.Driver()
    driver.reset(RobotSpec.from_scenario(world), seed=0)
    driver.hold(["down"])
    assert driver.act(Observation(*[np.zeros(3)] * 4))[0] == -0.4


def test_a_drive_is_an_episode_of_what_was_pressed(press):
    press((pygame.KEYDOWN, pygame.K_w), (pygame.KEYDOWN, pygame.K_LSHIFT))
    episode = human.drive(SCENARIO, seed=900000)
    assert (episode.agent, episode.outcome, episode.seed) == ("human", "timeout", 900000)
    np.testing.assert_array_equal(episode.actions, [[0.5, 0.0]] * SCENARIO.max_steps)
    assert not pygame.display.get_init(), "the window is closed"


def test_a_key_that_is_let_go_steers_no_more(press):
    press(
        (pygame.KEYDOWN, pygame.K_UP), (pygame.KEYDOWN, pygame.K_LEFT), (pygame.KEYUP, pygame.K_UP)
    )
    episode = human.drive(SCENARIO, seed=900000)
    assert set(episode.actions[:, 0]) == {0.0}
    assert set(episode.actions[:, 1]) == {1.5}


@pytest.mark.parametrize(
    "event",
    [(pygame.KEYDOWN, pygame.K_ESCAPE), (pygame.QUIT, None), (pygame.WINDOWCLOSE, None)],
)
@pytest.mark.parametrize("before", [[], [(pygame.KEYDOWN, pygame.K_UP)]])
def test_escape_and_the_windows_cross_end_it(press, event, before):
    press(*before, event)
    with pytest.raises(human.QuitError):
        human.drive(SCENARIO, seed=900000)
    assert not pygame.display.get_init(), "the window is closed"


def test_a_drive_leaves_the_windows_of_environments_open(press):
    env = CrowdEnv(SCENARIO, render_mode="human")
    env.reset(seed=0)
    env.render()
    press((pygame.KEYDOWN, pygame.K_UP))
    human.drive(SCENARIO, seed=900000)
    assert pygame.display.get_init()
    env.render()
    env.close()
    assert not pygame.display.get_init()


def test_one_person_drives_at_a_time():
    window = human.Window("first", (40, 30), human.Driver())
    with pytest.raises(human.NoDisplayError, match="drives in this process already"):
        human.drive(SCENARIO, seed=900000)
    window.show(pygame.Surface((40, 30)))  # the first goes on
    window.close()
    human.Window("next", (40, 30), human.Driver()).close()


def test_a_window_that_was_closed_ends_the_drive():
    window = human.Window("closed", (40, 30), human.Driver())
    window.close()
    for action in (
        lambda: window.show(pygame.Surface((40, 30))), window.wait_for_a_key,
    ):  # fmt: skip
        with pytest.raises(human.QuitError):
            action()
    window.close()


def test_without_a_display_it_says_so(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(human.NoDisplayError, match="needs a display"):
        human.drive(SCENARIO, seed=900000)


def test_with_a_display_that_does_not_answer_it_says_so(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "no_such_driver")
    with pytest.raises(human.NoDisplayError, match=r"needs a display: .*no_such_driver"):
        human.drive(SCENARIO, seed=900000)


def test_a_drive_is_stored_like_any_other_episode(press, tmp_path):
    press((pygame.KEYDOWN, pygame.K_UP))
    episode = human.drive(SCENARIO, seed=0)
    assert human.next_seed(SCENARIO, tmp_path) == 0
    human.store_drive(SCENARIO, episode, tmp_path)
    assert human.next_seed(SCENARIO, tmp_path) == 1
    (row,) = load_results(tmp_path).itertuples()
    assert (row.agent, row.seed, row.outcome, row.steps) == ("human", 0, "timeout", 20)
    (cell,) = find_cells(tmp_path)
    (stored,) = load_episodes(tmp_path, cell, SCENARIO, seed=0)
    np.testing.assert_array_equal(stored.robot_pose, episode.robot_pose)


def test_row_and_commands_of_a_drive_are_stored_together_or_not_at_all(
    press, tmp_path, monkeypatch
):
    press((pygame.KEYDOWN, pygame.K_UP))
    episode = human.drive(SCENARIO, seed=0)

    def fails(commands, inference_s):
        raise OSError("the disk is gone")

    with monkeypatch.context() as patch, pytest.raises(ResultsError):
        patch.setattr("crowdbench.evaluation.inserts.packed", fails)
        human.store_drive(SCENARIO, episode, tmp_path)
    assert load_results(tmp_path).empty
    human.store_drive(SCENARIO, episode, tmp_path)
    (cell,) = find_cells(tmp_path)
    assert load_episodes(tmp_path, cell, SCENARIO, seed=0) is not None
