"""Speed and memory of the simulation on one core, with random actions and resets included.

Run ``python benchmarks/simulation.py [SCENARIO ...]``. Prints environment steps per second through
the PettingZoo API, what the stacked obstacle map of the learned agents costs on top, the start-up
time of the command line, and the memory of 32 environments in one process.

``python benchmarks/simulation.py --peers PYTHON``, with a Python that has navground and IR-SIM (see
``benchmarks/peers.py``), prints steps a second of processor time of one environment, of the vector
environment and of the peers in a scene of the same size, taken in turns.

``python benchmarks/simulation.py --tier hard situation`` prints the processor time of a step in
every scenario of these tiers, without resets, and its ratio to that of ``multimodal_fast`` with as
many people: of one environment, and of one of 64 lanes.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Column, Table

import crowdbench

STEPS, REPEATS = 10_000, 5
ROUNDS, LANES = 20, 64
"""Turns of ``--tier``, for medians on a machine that does other things too."""


def steps_per_second(scenario: str) -> tuple[float, float]:
    """Median over repeats, and the share of resets in the time."""
    env = crowdbench.parallel_env(scenario)
    env.reset(seed=0)
    rates, shares = [], []
    for repeat in range(REPEATS + 1):
        actions = np.random.default_rng(repeat).uniform([0, -1.5], [1, 1.5], (STEPS, 2))
        begin, resetting = time.perf_counter(), 0.0
        for action in actions.astype(np.float32):
            env.step({"robot_0": action})
            if not env.agents:
                moment = time.perf_counter()
                env.reset()
                resetting += time.perf_counter() - moment
        duration = time.perf_counter() - begin
        rates.append(STEPS / duration)
        shares.append(resetting / duration)
    # The first repeat loads compiled kernels.
    return float(np.median(rates[1:])), float(np.median(shares[1:]))


def map_microseconds(scenario: str) -> float:
    """Median cost of moving eight scans into the robot frame."""
    env = crowdbench.parallel_env(scenario)
    observation = env.reset(seed=0)[0]["robot_0"]
    robot = env.robot_spec()
    stack = crowdbench.ObstacleMap(robot)
    costs = []
    for _ in range(2_000):
        begin = time.perf_counter()
        stack.update(observation["lidar"], observation["pose"])
        costs.append(time.perf_counter() - begin)
    return float(np.median(costs)) * 1e6


def startup_seconds(*arguments: str) -> float:
    """Median wall time of a fresh Python process."""
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


def memory_of_32() -> float:
    """Peak memory of this process with 32 environments that have run [MB]."""
    envs = [crowdbench.parallel_env("multimodal_fast") for _ in range(32)]
    for seed, env in enumerate(envs):
        env.reset(seed=seed)
        for _ in range(20):
            if env.agents:
                env.step({"robot_0": (0.5, 0.1)})
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def one_environment(scenario: str) -> Callable[[], float]:
    """Return a function that takes a thousand steps: steps per second of processor time."""
    env = crowdbench.parallel_env(scenario)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform([0, -1.5], [1, 1.5], (1000, 2)).astype(np.float32)

    def run() -> float:
        begin = time.process_time()
        for action in actions:
            env.step({"robot_0": action})
            if not env.agents:
                env.reset()
        return len(actions) / (time.process_time() - begin)

    return run


def vector_environment(scenario: str, lanes: int) -> Callable[[], float]:
    """Return a function that takes a hundred steps in all lanes, likewise."""
    env = crowdbench.vector_env(scenario, lanes, autoreset_mode="SameStep")
    env.reset(seed=0)
    draw = np.random.default_rng(0)
    actions = draw.uniform([0, -1.5], [1, 1.5], (100, lanes, 2)).astype(np.float32)

    def run() -> float:
        begin = time.process_time()
        for action in actions:
            env.step(action)
        return len(actions) * lanes / (time.process_time() - begin)

    return run


def peer(python: str, name: str) -> Callable[[], float]:
    """Return a function that has a peer, in a process of its own, do the same."""
    command = [python, str(Path(__file__).with_name("peers.py")), name]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    source, answers = process.stdin, process.stdout
    assert source is not None
    assert answers is not None

    def run() -> float:
        source.write("\n")
        source.flush()
        # IR-SIM prints lines of its own.
        return next(float(line.split()[1]) for line in answers if line.startswith("rate "))

    return run


def compare_with_peers(python: str, console: Console) -> None:
    """Print the table of ``--peers``: medians of rounds in which everybody takes a turn."""
    takers = {
        "crowdbench, one environment": one_environment("multimodal_fast"),
        **{
            f"crowdbench, {lanes} lanes": vector_environment("multimodal_fast", lanes)
            for lanes in (16, 64, 256)
        },
        "navground": peer(python, "navground"),
        "IR-SIM": peer(python, "irsim"),
    }
    rounds = [{name: run() for name, run in takers.items()} for _ in range(REPEATS + 1)][1:]
    table = Table("one core", "steps/s", "of navground's")
    for name in takers:
        rate = np.median([rates[name] for rates in rounds])
        share = np.median([rates[name] / rates["navground"] for rates in rounds])
        table.add_row(name, f"{rate:,.0f}", f"{share:.2f}")
    console.print(table)


def step_of_one(scenario: crowdbench.Scenario) -> Callable[[], float]:
    """Return a function that takes 250 steps: processor time of one, resets apart [us]."""
    env = crowdbench.parallel_env(scenario)
    env.reset(seed=900_000)
    actions = np.random.default_rng(0).uniform([0, -1.5], [1, 1.5], (250, 2)).astype(np.float32)

    def run() -> float:
        begin, resetting = time.process_time(), 0.0
        for action in actions:
            env.step({"robot_0": action})
            if not env.agents:
                moment = time.process_time()
                env.reset()
                resetting += time.process_time() - moment
        return (time.process_time() - begin - resetting) / len(actions) * 1e6

    return run


def step_of_lanes(scenario: crowdbench.Scenario) -> Callable[[], float]:
    """Return a function that takes 20 steps in all lanes: likewise, of one lane."""
    env = crowdbench.vector_env(scenario, LANES, autoreset_mode="Disabled")
    env.reset(seed=900_000)
    draw = np.random.default_rng(0)
    actions = draw.uniform([0, -1.5], [1, 1.5], (20, LANES, 2)).astype(np.float32)

    def run() -> float:
        begin, resetting = time.process_time(), 0.0
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            if (over := terminated | truncated).any():
                moment = time.process_time()
                env.reset(options={"reset_mask": over})
                resetting += time.process_time() - moment
        return (time.process_time() - begin - resetting) / len(actions) / LANES * 1e6

    return run


def compare_with_open(tiers: list[str], console: Console) -> None:
    """Print the table of ``--tier``: medians of rounds in which both scenarios take turns."""
    name_column = Column("scenario", no_wrap=True)
    table = Table(name_column, "people", "one, us", "ratio", f"{LANES} lanes, us", "ratio")
    for name in (name for tier in tiers for name in crowdbench.scenario_names(tier)):
        scenario = crowdbench.load_scenario(name)
        people = scenario.pedestrians.count
        easy = crowdbench.load_scenario("multimodal_fast", pedestrians={"count": people})
        cells = []
        for step_of in (step_of_one, step_of_lanes):
            hard_step, easy_step = step_of(scenario), step_of(easy)
            costs = np.array([(hard_step(), easy_step()) for _ in range(ROUNDS + 1)][1:])
            ratio = np.median(costs[:, 0] / costs[:, 1])
            cells += [f"{np.median(costs[:, 0]):.1f}", f"{ratio:.2f}"]
        table.add_row(name, str(people), *cells)
    console.print(table)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--peers", metavar="PYTHON", help="compare with peers that this one has")
    tiers = crowdbench.scenario_tiers()
    parser.add_argument("--tier", nargs="+", choices=tiers, help="compare with multimodal_fast")
    parser.add_argument("scenarios", nargs="*", default=["multimodal_fast", "corridor_very_dense"])
    console = Console()
    arguments = parser.parse_args()
    try:
        for name in arguments.scenarios:
            crowdbench.load_scenario(name)
    except crowdbench.ScenarioError as error:
        parser.error(str(error))
    if arguments.peers and shutil.which(arguments.peers) is None:
        parser.error(f"--peers: {arguments.peers}: no such program")
    if arguments.peers:
        imported = [arguments.peers, "-c", "import irsim, navground.learning"]
        tried = subprocess.run(imported, capture_output=True, text=True, check=False)
        if tried.returncode:
            reason = (tried.stderr.strip().splitlines() or ["no Python"])[-1]
            parser.error(f"--peers: {arguments.peers}: {reason}; see benchmarks/peers.py")
        compare_with_peers(arguments.peers, console)
        return
    if arguments.tier:
        compare_with_open(arguments.tier, console)
        return
    memory = memory_of_32()
    table = Table("scenario", "steps/s", "of that resets", "obstacle map, us/step")
    for scenario in arguments.scenarios:
        rate, share = steps_per_second(scenario)
        table.add_row(scenario, f"{rate:,.0f}", f"{share:.0%}", f"{map_microseconds(scenario):.1f}")
    console.print(table)
    console.print(f"32 environments in one process: {memory:.0f} MB peak")
    console.print(f"import crowdbench: {startup_seconds('-c', 'import crowdbench'):.2f} s")
    console.print(f"crowdbench --help: {startup_seconds('-m', 'crowdbench.cli', '--help'):.2f} s")


if __name__ == "__main__":
    main()
