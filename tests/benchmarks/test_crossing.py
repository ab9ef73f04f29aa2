"""The tables of crossed recordings: by hand, and from a small recording to a page."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from crossings import walking

from crowdbench.evaluation.results import load_results

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "crossing.py"


@pytest.fixture
def benchmark():
    spec = importlib.util.spec_from_file_location("crossing_benchmark", BENCHMARK)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def rows(success, delay):
    """Episodes of seeds 0, 1, ... that differ in what the table shows."""
    columns = {"success": success, "spl": success, "delay": delay, "delay_by_chance": 0.0}
    others = dict.fromkeys(["detour", "displacement", "detour_by_chance", "displacement_by_chance"])
    return pd.DataFrame({"seed": range(len(success)), **columns, **others})


def test_blocks_are_drawn_with_all_of_their_episodes(benchmark):
    """Two blocks, of one episode and of three: means of 0, 1 and, one draw in two, 3 / 4."""
    low, high = benchmark.block_interval([0, 1, 1, 1, np.nan], np.array([3, 7, 7, 7, 3]))
    assert (low, high) == (0.0, 1.0)
    # Equal blocks differ in nothing, however their episodes do.
    assert benchmark.block_interval([0, 1, 0, 1], np.array([0, 0, 1, 1])) == (0.5, 0.5)
    assert np.isnan(benchmark.block_interval([0, 1], np.array([4, 4]))).all()


def test_many_blocks_of_one_episode_are_an_ordinary_bootstrap(benchmark):
    values = np.random.default_rng(1).normal(size=400)
    low, high = benchmark.block_interval(values, np.arange(400))
    error = 1.96 * values.std() / 20
    assert (low, high) == pytest.approx(
        (values.mean() - error, values.mean() + error), abs=0.2 * error
    )


@pytest.mark.parametrize("ceiling, ranked", [([1, 1, 0, 0], True), ([1, 0, 0, 0], False)])
def test_agents_are_ranked_where_the_ceiling_crosses_half_of_the_time(benchmark, ceiling, ranked):
    episodes = benchmark.Episodes(np.array([0, 0, 1, 1]), np.array([10, 12, 14, 20]))
    lines = benchmark.table(
        "Square",
        {
            "informed": rows(ceiling, [0.0] * 4),
            "orca": rows([0, 0, 0, 1], [0.1, 0.1, 0.3, 0.3]),
            "neupan": rows([1, 1, 0, 1], [0.0, 0.02, 0.0, 0.02]),
        },
        episodes,
    ).splitlines()
    order = [line.split("`")[1] for line in lines if line.startswith("| `")]
    assert order == (["informed", "neupan", "orca"] if ranked else ["informed", "orca", "neupan"])
    assert ("not ranked, since `informed` crosses it in 0.25" in lines[0]) != ranked
    (orca,) = (line for line in lines if "`orca`" in line)
    # One success in four: blocks have 0 and 1/2; of four episodes Wilson's interval is wider.
    assert "| 0.25 [0.00, 0.70] |" in orca
    assert "| 200.0 [100.0, 300.0] |" in orca
    assert "2 blocks of 10 s; within 20 s 14 people" in lines[-1]


def test_a_small_recording_is_crossed_and_its_table_put_into_a_page(
    benchmark, tmp_path, monkeypatch
):
    (tmp_path / "walk.csv").write_text(walking(persons=8, seconds=40))
    page, results = tmp_path / "page.md", tmp_path / "results"
    page.write_text(f"# People\n{benchmark.BEGIN}\nold\n{benchmark.END}\nmore\n")
    monkeypatch.setattr(benchmark, "RECORDINGS", {"Two rows": ("walk.csv", {})})
    monkeypatch.setattr(benchmark, "CEILING", "straight_line")
    monkeypatch.setattr(sys, "argv", [
        "crossing.py", str(tmp_path), "--agents", "straight_line", "--episodes", "2",
        "--jobs", "1", "--results", str(results), "--page", str(page),
    ])  # fmt: skip
    benchmark.main()
    stored = load_results(results)
    assert stored["seed"].tolist() == [0, 1]
    assert stored[["delay", "displacement_by_chance"]].notna().all(axis=None)
    text = page.read_text()
    assert f"| `straight_line` | {stored['success'].mean():.2f} [" in text
    assert "old" not in text
    assert text.startswith("# People\n") and text.endswith(f"{benchmark.END}\nmore\n")


def test_a_page_without_marks_is_refused(benchmark, tmp_path):
    (tmp_path / "page.md").write_text("# People\n")
    with pytest.raises(SystemExit, match=r"page.md: expected <!-- crossing: begin -->"):
        benchmark.insert(tmp_path / "page.md", "text")
