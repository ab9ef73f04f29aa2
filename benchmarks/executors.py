"""Throughput of the executors: episodes per second on Ray against worker processes of this machine.

Run ``python benchmarks/executors.py [AGENT ...]``. Both executors have two workers, are started
before the first episode and take turns; what is timed is what the runner does, simulating and
measuring included. Prints the median of each and of the ratios of neighbouring turns. An agent
that takes no time shows what an executor costs; one that plans shows what it costs in practice.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections import deque
from collections.abc import Sequence

from crowdbench_agents.learning.seeds import VALIDATION
from rich.console import Console
from rich.table import Table

import crowdbench
from crowdbench.evaluation.executors import EXECUTORS, Executor
from crowdbench.evaluation.pool import Limits
from crowdbench.evaluation.protocol import Describe, Described, Done, Job, Message
from crowdbench.evaluation.results import Cell
from crowdbench.evaluation.scoring import Scorer

SCENARIO = crowdbench.load_scenario("multimodal_fast")


def main() -> None:
    """Take turns and print a line per agent."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("agents", nargs="*", default=["straight_line", "orca"])
    parser.add_argument("--episodes", type=int, default=60, help="of one turn")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()

    table = Table("agent", "local [1/s]", "ray [1/s]", "ray / local")
    local, ray = (
        EXECUTORS[name](options.workers, Limits(), address)
        for name, address in (("local", None), ("ray", "local"))
    )
    with local, ray:
        for agent in options.agents:
            cells = [_identified(executor, agent) for executor in (local, ray)]
            rates: list[tuple[float, float]] = []
            for repeat in range(options.repeats + 1):
                first = VALIDATION[0] + repeat * options.episodes
                seeds = range(first, first + options.episodes)
                one, other = (
                    _rate(
                        executor,
                        [
                            Job(SCENARIO, crowdbench.AgentSpec(agent, {}), cell, seed)
                            for seed in seeds
                        ],
                    )
                    for executor, cell in zip((local, ray), cells, strict=True)
                )
                if repeat:  # the first turn loads and compiles
                    rates.append((one, other))
            ratios = [other / one for one, other in rates]
            medians = [statistics.median(values) for values in (*zip(*rates, strict=True), ratios)]
            table.add_row(agent, f"{medians[0]:.2f}", f"{medians[1]:.2f}", f"{medians[2]:.2f}")
    Console(highlight=False).print(table)


def _identified(executor: Executor, agent: str) -> Cell:
    """The cell of an agent's episodes, as its first process describes it."""
    executor.prepare(100)
    (reply,) = executor.run(deque[Message]([Describe(crowdbench.AgentSpec(agent, {}))]))
    assert isinstance(reply.answer, Described)
    weights, code = reply.answer.weights_sha256, reply.answer.code
    return Cell(SCENARIO.name, SCENARIO.digest, agent, "{}", "", weights, code)


def _rate(executor: Executor, jobs: Sequence[Job]) -> float:
    """Episodes per second until the last one is measured."""
    scorer, begun = Scorer(), time.perf_counter()
    for message, answer, origin in executor.run(deque[Message](jobs)):
        assert isinstance(message, Job) and isinstance(answer, Done)
        label = message.cell.agent
        scorer.score(message.scenario, label, message.seed, answer.driven, origin.now())
    return len(jobs) / (time.perf_counter() - begun)


if __name__ == "__main__":
    main()
