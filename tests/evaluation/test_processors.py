"""The same episodes on an older processor: numpy and BLAS are kept from what newer ones have."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig

import numpy as np
import pytest

AGENTS = ("straight_line", "orca", "dynamic_window", "informed")
SEEDS = {"multimodal_fast": (0, 1), "corridor_very_dense": (2, 3)}
OLDER = {
    "NPY_DISABLE_CPU_FEATURES": " ".join(np.show_config("dicts")["SIMD Extensions"]["found"]),
    "OPENBLAS_CORETYPE": "Nehalem",  # the first that its wheels have a kernel for
}

_EPISODES = f"""
import json
from crowdbench.evaluation.metrics import metrics
from crowdbench.evaluation.rollout import run_episode

found = {{}}
for scenario, seeds in {SEEDS}.items():
    for agent in {AGENTS}:
        for seed in seeds:
            (episode,) = run_episode(scenario, agent, seed)
            assert episode.error is None, episode.error
            values = {{**metrics(episode), "inference_s": None}}
            place = episode.robot_pose.tobytes().hex(), episode.pedestrian_velocity.tobytes().hex()
            found[f"{{agent}}, {{scenario}}, {{seed}}"] = place, repr(values)
print(json.dumps(found))
"""


def episodes_with(**environment):
    answer = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", _EPISODES],
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(answer.stdout)


@pytest.fixture(scope="module")
def here():
    return episodes_with()


def test_episodes_and_metrics_do_not_depend_on_what_numpy_finds_in_the_processor(here):
    older = episodes_with(**OLDER)
    assert [name for name in here if here[name] != older[name]] == []


@pytest.mark.slow
@pytest.mark.skipif("x86_64" not in sysconfig.get_platform(), reason="a setting for x86")
def test_nor_on_what_compiled_functions_may_use(here, tmp_path):
    older = episodes_with(**OLDER, NUMBA_CPU_NAME="generic", NUMBA_CACHE_DIR=str(tmp_path))
    assert [name for name in here if here[name] != older[name]] == []
