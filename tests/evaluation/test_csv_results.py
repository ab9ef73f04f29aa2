"""Results as crowdbench 0.1.0 wrote them, and what becomes of them."""

from __future__ import annotations

import csv
import json
import re
import struct
import zlib
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from crowdbench import load_scenario
from crowdbench.cli import main
from crowdbench.evaluation.csv_results import read_csv_cells
from crowdbench.evaluation.database import ResultsError
from crowdbench.evaluation.metrics import metrics
from crowdbench.evaluation.results import (
    Cell,
    Origin,
    Result,
    ResultsStore,
    load_commands,
    load_results,
)
from crowdbench.evaluation.rollout import run_episode
from crowdbench.simulation import WORLD_VERSION

WORLD = load_scenario("multimodal_fast", time_limit=2.0)
LABEL = f"multimodal_fast@{WORLD.digest}"
CELL = Cell(LABEL, WORLD.digest, "straight_line", "{}", "0.1", "", "crowdbench-nav 0.1.0")
CELL_OF_0_1_0 = {key: value for key, value in vars(CELL).items() if key != "world"} | {
    "version": "0.1.0"
}


def member(episode, cell=CELL):
    """A whole episode as 0.1.0 stored it: one gzip member that names itself."""
    document = {
        "actions": {"dtype": "float64", "data": episode.actions.ravel().tolist()},
        "inference_s": {"dtype": "float64", "data": episode.inference_s.tolist()},
    }
    text = json.dumps(document).encode() + b"\n"
    name = json.dumps([episode.seed, episode.robot, cell.identity]).encode()
    packer = zlib.compressobj(wbits=-zlib.MAX_WBITS)
    body = packer.compress(text) + packer.flush()
    size = 12 + 12 + len(name) + len(body) + 8
    head = struct.pack("<4sLBBH", b"\x1f\x8b\x08\x04", 0, 0, 255, 12 + len(name))
    extra = struct.pack("<2sHQ", b"CB", 8 + len(name), size) + name
    return head + extra + body + struct.pack("<LL", zlib.crc32(text), len(text))


@pytest.fixture(scope="module")
def episodes():
    return [run_episode(WORLD, "straight_line", seed)[0] for seed in range(3)]


@pytest.fixture
def old(tmp_path, episodes):
    """A folder of 0.1.0 with three rows, of which the first two are kept whole."""
    rows = [
        {
            **CELL_OF_0_1_0, "seed": episode.seed, "robot": episode.robot,
            "outcome": episode.outcome, **metrics(episode), "steps": episode.steps,
            "error": "", "diagnostics": "{}",
            "machine": "a machine, 2 cores", "timestamp": "2026-01-01T00:00:00+00:00",
        }
        for episode in episodes
    ]  # fmt: skip
    place = tmp_path / "old" / "episodes" / LABEL
    place.mkdir(parents=True)
    with (place / "straight_line.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    (place / "scenario.json").write_text(WORLD.model_dump_json())
    whole = tmp_path / "old" / "trajectories" / LABEL
    whole.mkdir(parents=True)
    (whole / "straight_line.jsonl.gz").write_bytes(b"".join(map(member, episodes[:2])))
    return tmp_path / "old"


def rows_file(old):
    return old / "episodes" / LABEL / "straight_line.csv"


def test_old_results_are_taken_over_exactly_and_are_of_another_world(
    old, tmp_path, episodes, capsys
):
    target = tmp_path / "new"
    arguments = ["import", str(old), "--results", str(target)]
    assert main(arguments) == 0
    told = "3 rows imported, 0 were there; 2 of them with commands"
    assert capsys.readouterr().out == f"{target / 'results.sqlite'}: {told}\n"
    rows = ResultsStore(target).rows(CELL)
    for row, episode in zip(rows.to_dict("records"), episodes, strict=True):
        for name, value in metrics(episode).items():
            np.testing.assert_array_equal(row[name], value, err_msg=name)
        assert (row["machine"], row["version"]) == ("a machine, 2 cores", "0.1.0")
        assert (row["architecture"], row["torch"]) == ("", ""), "0.1.0 did not note them"
    np.testing.assert_array_equal(load_commands(target, CELL, 1)[0], episodes[1].actions)
    assert load_commands(target, CELL, 2) is None
    assert main(arguments) == 0
    assert "0 rows imported, 3 were there" in capsys.readouterr().out
    with pytest.warns(UserWarning, match="3 rows are of world '0.1' and left out"):
        assert load_results(target).empty


def test_what_a_kill_cut_off_is_left_out(old):
    whole = rows_file(old).read_bytes()
    rows_file(old).write_bytes(whole[:-5])
    kept = old / "trajectories" / LABEL / "straight_line.jsonl.gz"
    kept.write_bytes(kept.read_bytes()[:-5])
    (part,) = read_csv_cells(old)
    assert [result.seed for result in part.results] == [0, 1]
    assert [result.commands is not None for result in part.results] == [True, False]


def test_a_scenario_that_is_not_known_any_more_is_left_open(old):
    (old / "episodes" / LABEL / "scenario.json").write_text("{}")
    (part,) = read_csv_cells(old)
    assert part.scenario is None


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda text: text + "a,b\n", r"line 5: not a row of results \(expected \d+ fields, got 2"),
        (lambda text: text.replace(",robot_0,", ",robot_0,x", 1), r"line 2: .*outcome x"),
        (lambda text: text.replace(",timestamp", ",time", 1), "line 1: .*lacks timestamp"),
        (lambda text: text.replace(",0,robot_0", ",zero,robot_0", 1), "line 2: .*invalid literal"),
        (lambda text: re.sub(r",(timeout|collision|success),\d", r",\1,7", text, count=1),
         r"line 2: .*success is 7.0, expected 0, 1 or nan"),
        (lambda text: text.replace(",{},", ",5,"), "line 2: .*diagnostics 5, expected counters"),
        (lambda text: text.replace(",{},", f",{'[' * 3000},"), "line 2: .*nested too deeply"),
    ],
)  # fmt: skip
def test_a_row_that_is_none_is_reported_with_file_and_line(old, tmp_path, capsys, change, told):
    rows_file(old).write_text(change(rows_file(old).read_text()))
    assert main(["import", str(old), "--results", str(tmp_path / "new")]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"{rows_file(old)}, line ") and error.count("\n") == 1
    assert re.search(told, error)
    assert load_results(tmp_path / "new").empty


def test_a_damaged_whole_episode_is_reported_with_its_file(old):
    path = old / "trajectories" / LABEL / "straight_line.jsonl.gz"
    data = bytearray(path.read_bytes())
    data[len(data) // 4] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(ResultsError, match=r"straight_line\.jsonl\.gz, byte \d+: not a whole epi"):
        list(read_csv_cells(old))


def test_a_folder_of_something_else_is_refused(tmp_path, capsys):
    assert main(["import", str(tmp_path), "--results", str(tmp_path / "new")]) == 2
    assert "no results of crowdbench 0.1.0" in capsys.readouterr().err


def test_rows_are_exported_as_they_are(episodes, tmp_path, capsys):
    results = ["--results", str(tmp_path / "new")]
    cell = replace(CELL, world=WORLD_VERSION)
    stored = [Result.of(episode, metrics(episode), Origin()) for episode in episodes]
    ResultsStore(tmp_path / "new").append(cell, stored, WORLD)
    output = tmp_path / "out" / "rows.csv"
    assert main(["export", *results, "-o", str(output)]) == 0
    assert capsys.readouterr().out == f"{output}: 3 rows\n"
    assert main(["export", *results]) == 0
    assert capsys.readouterr().out == output.read_text()
    exported, rows = pd.read_csv(output, keep_default_na=False), load_results(tmp_path / "new")
    assert list(exported.columns) == list(rows.columns)
    assert list(exported["path_length"]) == list(rows["path_length"])
    assert [path.name for path in output.parent.iterdir()] == ["rows.csv"]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--format", "parquet"], "name one with --output"),
        (["--format", "parquet", "-o", "rows.parquet"], "needs pyarrow"),
        ([], "no episodes are stored here"),
    ],
)
def test_what_cannot_be_exported_is_answered_in_one_line(
    tmp_path, monkeypatch, capsys, arguments, told
):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["export", "--results", str(tmp_path), *arguments]) == 2
    error = capsys.readouterr().err
    assert told in error and error.count("\n") == 1
