"""Stored episodes as a data set of Minari: what is loaded is what happened."""

import gymnasium
import minari
import numpy as np
import pytest

import crowdbench
from crowdbench.cli import main

SCENARIO = crowdbench.load_scenario("unimodal_fast", time_limit=8.0)
SHORT = ["unimodal_fast", "--set", "time_limit=8.0"]
SEEDS = range(1_000_000, 1_000_005)


@pytest.fixture(autouse=True)
def _datasets(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))


@pytest.fixture
def export(whole, capsys):
    """Runs the command on the results of a test; returns its exit code and what it said."""

    def run(*arguments, agent="straight_line"):
        results = ["--results", str(whole.folder), "--agent", agent]
        code = main(["export-minari", *arguments, *results])
        told = capsys.readouterr()
        return code, " ".join((told.out + told.err).split())

    return run


def test_episodes_are_what_happens_with_their_seeds_and_commands(whole, export):
    for seed in SEEDS:
        whole.run(SCENARIO, "straight_line", seed)
    code, told = export(*SHORT, "crowd/straight-v0")
    assert code == 0
    assert "crowd/straight-v0: 5 episodes" in told
    assert "compared" not in told

    dataset = minari.load_dataset("crowd/straight-v0")
    env = gymnasium.make("crowdbench:CrowdNav-v0", scenario=SCENARIO)
    assert dataset.spec.observation_space == env.observation_space
    assert dataset.spec.action_space == env.action_space
    metadata = list(dataset.storage.get_episode_metadata(range(5)))
    assert [item["seed"] for item in metadata] == list(SEEDS)
    outcomes = set()
    for item, facts in zip(dataset.iterate_episodes(), metadata, strict=True):
        logs = [log for (*_, seed, _), log in whole.episodes.items() if seed == facts["seed"]]
        (log,) = logs
        seen, _ = env.reset(seed=facts["seed"])
        for step, command in enumerate(log.commands):
            for key, value in seen.items():
                np.testing.assert_array_equal(item.observations[key][step], value)
            seen, *rest, _ = env.step(command)
            assert rest == [item.rewards[step], item.terminations[step], item.truncations[step]]
        for key, value in seen.items():
            np.testing.assert_array_equal(item.observations[key][log.steps], value)
        assert len(item.rewards) == log.steps
        clipped = np.clip(log.commands, [0.0, -1.5], [1.0, 1.5])
        np.testing.assert_array_equal(item.actions, clipped.astype(np.float32))
        assert facts["outcome"] == log.outcome
        assert item.truncations[-1] == (log.outcome == "timeout")
        outcomes.add(log.outcome)
    assert {"success", "collision"} <= outcomes


@pytest.mark.parametrize("changes", [{}, {"time_limit": 8.0, "pedestrians.count": 3}])
def test_the_environment_is_recovered_with_its_scenario(whole, export, changes):
    scenario = crowdbench.load_scenario("unimodal_fast", **changes)
    whole.run(scenario, "straight_line", 1_000_000)
    fields = [f"--set={key}={value}" for key, value in changes.items()]
    assert export("unimodal_fast", "one-v0", *fields)[0] == 0
    env = minari.load_dataset("one-v0").recover_environment()
    assert env.unwrapped.crowd.scenario == scenario


def test_an_episode_that_an_error_has_ended_is_truncated(whole, export, tmp_path):
    path = tmp_path / "failing.py"
    path.write_text(
        "import crowdbench\n"
        "class Failing(crowdbench.Agent):\n"
        "    def reset(self, robot, seed):\n"
        "        self.left = seed % 2 * 3\n"
        "    def act(self, observation):\n"
        "        self.left -= 1\n"
        "        assert self.left >= 0\n"
        "        return 0.5, 0.0\n"
    )
    logs = [whole.run(SCENARIO, f"{path}:Failing", seed) for seed in range(1_000_000, 1_000_008)]
    failed_late = [log for log in logs if log.steps]
    assert {log.steps for log in logs} == {0, 3}
    assert export(*SHORT, "failing-v0", agent=f"{path}:Failing")[0] == 0
    dataset = minari.load_dataset("failing-v0")
    assert dataset.total_episodes == len(failed_late)
    for item in dataset.iterate_episodes():
        assert item.terminations.tolist() == [False] * 3
        assert item.truncations.tolist() == [False, False, True]


def test_whoever_exports_test_episodes_is_told(whole, export):
    whole.run(SCENARIO, "straight_line", 999)
    code, told = export(*SHORT, "test-v0")
    assert code == 0
    assert "1 of these episodes have seeds below 1,000, on which agents are compared" in told


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ([*SHORT, "straight"], "data set 'straight': expected [NAMESPACE/]NAME-vNUMBER"),
        ([*SHORT, "../up-v0"], "data set '../up-v0': expected [NAMESPACE/]NAME-vNUMBER"),
        (["corridor_sparse", "straight-v0"], "no episodes of straight_line in corridor_sparse"),
        ([*SHORT, "taken-v0"], "data set 'taken-v0': A Minari dataset with ID taken-v0 already"),
    ],
)
def test_what_cannot_be_exported_is_a_line(whole, export, arguments, told):
    whole.run(SCENARIO, "straight_line", 1_000_000)
    assert export(*SHORT, "taken-v0")[0] == 0
    code, said = export(*arguments)
    assert code == 2
    assert told in said


def test_an_episode_that_is_not_what_was_stored_is_named(whole, export):
    whole.run(SCENARIO, "straight_line", 1_000_000, outcome="timeout")
    code, said = export(*SHORT, "other-v0")
    assert code == 2
    assert "seed 1000000: said to end with timeout after" in said


def test_several_robots_are_no_data_set_of_one(whole, export):
    whole.run(SCENARIO.override({"robots.count": 2}), "straight_line", 1_000_000)
    code, said = export(*SHORT, "--set", "robots.count=2", "two-v0")
    assert code == 2
    assert "the Gymnasium view needs robots.count = 1" in said


def test_without_minari_it_says_what_to_install(export, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    code, said = export(*SHORT, "straight-v0")
    assert code == 2
    assert "pip install 'crowdbench-nav[minari]'" in said
