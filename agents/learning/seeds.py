"""Which episode seeds are for what: no two uses share one.

Test episodes are driven for the tables and by nobody who trains or chooses. What is chosen (the
best weights of a run, settings of a planner) is chosen on validation seeds. Everything from
1,000,000 up is for learning.
"""

from __future__ import annotations

from crowdbench_agents.learning.errors import TrainingError

TEST = range(1_000)
VALIDATION = range(900_000, 901_000)
DEMONSTRATIONS = range(1_000_000, 10_000_000)
"""Shared by all runs."""
TRAINING = range(10_000_000, 1_900_000_000)
WORLD_MODEL_TEST = range(1_900_000_000, 2_000_000_000)
"""The data set of benchmarks/world_model.py."""

SEEDS_PER_RUN = 50_000_000


def training_seeds(run_seed: int) -> range:
    """The episode seeds of the training run of a seed; different runs share none.

    Raises:
        TrainingError: there are no episode seeds for a run of this seed.
    """
    runs = len(TRAINING) // SEEDS_PER_RUN
    if not 0 <= run_seed < runs:
        raise TrainingError(f"seed: a run's should be 0 to {runs - 1}, got {run_seed}")
    return TRAINING[run_seed * SEEDS_PER_RUN : (run_seed + 1) * SEEDS_PER_RUN]
