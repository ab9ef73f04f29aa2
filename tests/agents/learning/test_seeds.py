"""Which seeds are for what."""

import itertools

import pytest
from crowdbench_agents.learning import seeds
from crowdbench_agents.learning.errors import TrainingError


def test_no_two_uses_share_a_seed():
    uses = [
        seeds.TEST, seeds.VALIDATION, seeds.DEMONSTRATIONS, seeds.TRAINING, seeds.WORLD_MODEL_TEST,
    ]  # fmt: skip
    for first, second in itertools.pairwise(uses):
        assert first[-1] < second[0]
    assert (range(0, 1000), range(900_000, 901_000)) == (seeds.TEST, seeds.VALIDATION)
    assert seeds.DEMONSTRATIONS[0] == 1_000_000


def test_runs_of_different_seeds_see_different_episodes():
    first, second, last = (seeds.training_seeds(seed) for seed in (0, 1, 36))
    assert first[0] == seeds.TRAINING[0]
    assert first[-1] < second[0]
    assert last[-1] in seeds.TRAINING
    with pytest.raises(TrainingError, match="seed: a run's should be 0 to 36, got 37"):
        seeds.training_seeds(37)
