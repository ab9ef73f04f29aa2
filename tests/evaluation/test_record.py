"""The published record: what is written is read back exactly, and damage is named."""

import gzip
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from crowdbench import load_scenario
from crowdbench.evaluation.metrics import METRICS
from crowdbench.evaluation.record import (
    INSTALLED_SEEDS,
    VERSIONS,
    load_commands,
    load_record,
    read_record,
    write_cell,
)
from crowdbench.evaluation.results import Cell, ResultsError
from crowdbench.simulation import WORLD_VERSION

CELL = Cell(
    scenario="corridor_dense",
    scenario_digest=load_scenario("corridor_dense").digest,
    agent="planner:gain=2",
    options='{"gain": 2}',
    world=WORLD_VERSION,
    weights_sha256="00ff",
    code="crowdbench-nav 0.1.0",
)
SEEDS = (0, 7, 99, 100, 250)


def rows_of(cell=CELL, seeds=SEEDS, robots=1):
    """Rows with numbers that need every digit, one that is undefined, and awkward texts."""
    rng = np.random.default_rng(1)
    return pd.DataFrame(
        [
            {
                **vars(cell),
                "seed": seed,
                "robot": f"robot_{robot}",
                "outcome": "success",
                "success": 1.0,
                "spl": rng.random() / 3,
                "time_to_goal": np.nan,
                "steps": 3 + robot,
                "error": 'nan, "quoted"',
                "diagnostics": '{"plans": 3.0}',
                "machine": "NA",
                "architecture": "",
                "version": "0.1.0",
                "pymunk": "7.10",
                "numpy": "2.0",
                "torch": "",
                "timestamp": "2026-11-26T15:43:08+00:00",
            }
            for seed in seeds
            for robot in range(robots)
        ]
    )


def commands_of(rows):
    rng = np.random.default_rng(2)
    return {(row.seed, row.robot): rng.normal(size=(row.steps, 2)) for row in rows.itertuples()}


@pytest.fixture
def written(tmp_path):
    rows = rows_of()
    write_cell(tmp_path, CELL, rows, commands_of(rows))
    return tmp_path


def only_file(folder, kind):
    (path,) = (path for path in (folder / kind).rglob("*") if path.is_file())
    return path


def test_rows_come_back_to_the_last_bit(written):
    found = load_record(folder=written)
    assert set(found.pop("source")) == {"published"}
    columns = ("success", "spl", "time_to_goal")
    (lacking,) = set(found.pop("not_computed"))
    assert lacking.split() == [name for name in METRICS if name not in columns]
    pd.testing.assert_frame_equal(found, rows_of(), check_exact=True)


def test_a_metric_that_no_row_was_measured_with_has_no_column(tmp_path):
    write_cell(tmp_path, CELL, rows_of().assign(jerk=np.nan, not_computed="spl jerk"), {})
    found = load_record(folder=tmp_path)
    assert "jerk" not in found and "spl" not in found and "time_to_goal" in found


def test_rows_are_chosen_by_scenario_and_agent(written):
    other = replace(CELL, agent="orca", options="{}")
    write_cell(written, other, rows_of(other), {})
    assert set(load_record(agent="orca", folder=written)["agent"]) == {"orca"}
    assert len(load_record(folder=written)) == 2 * len(SEEDS)
    assert load_record(scenario="corridor_sparse", folder=written).empty


def test_commands_come_back_to_the_last_bit(tmp_path):
    rows = rows_of(robots=2)
    commands = commands_of(rows)
    write_cell(tmp_path, CELL, rows, commands)
    for seed in SEEDS:
        found = list(load_commands(CELL, tmp_path).of(seed).values())
        expected = [commands[seed, "robot_0"], commands[seed, "robot_1"]]
        assert [len(one) for one in found] == [3, 4]
        np.testing.assert_array_equal(np.concatenate(found), np.concatenate(expected))


def test_times_are_kept_as_far_as_they_are_known(tmp_path):
    rows = rows_of(seeds=(3, 200))
    times = {(3, "robot_0"): np.array([0.5, 0.25, 0.125])}
    write_cell(tmp_path, CELL, rows, commands_of(rows), times)
    found = load_commands(CELL, tmp_path)
    np.testing.assert_array_equal(found.times(3)["robot_0"], [0.5, 0.25, 0.125])
    assert np.isnan(found.times(200)["robot_0"]).tolist() == [True] * 3
    assert found.times(4) == found.of(4) == {}


def test_what_is_installed_holds_all_rows_and_the_commands_of_the_first_seeds(written):
    (written / "rest").rename(written / "away")
    assert list(load_record(folder=written)["seed"]) == list(SEEDS)
    assert load_commands(CELL, written).seeds == {s for s in SEEDS if s in INSTALLED_SEEDS}
    assert load_commands(CELL, written).of(250) == {}


def test_rows_without_commands_are_allowed(tmp_path):
    rows = rows_of()
    commands = commands_of(rows)
    write_cell(tmp_path, CELL, rows, {(7, "robot_0"): commands[7, "robot_0"]})
    assert load_commands(CELL, tmp_path).seeds == {7}
    write_cell(tmp_path, CELL, rows, {})
    assert load_commands(CELL, tmp_path).seeds == set()
    assert len(load_record(folder=tmp_path)) == len(SEEDS)


def test_the_same_rows_give_the_same_bytes_in_any_order(tmp_path):
    rows = rows_of()
    commands = commands_of(rows)
    write_cell(tmp_path / "a", CELL, rows, commands)
    backwards = dict(reversed(commands.items()))
    write_cell(tmp_path / "b", CELL, rows.iloc[::-1], backwards)
    for kind in ("rows", "actions", "rest"):
        one, other = (only_file(tmp_path / name, kind) for name in "ab")
        assert one.read_bytes() == other.read_bytes()


def test_columns_of_the_cell_and_of_the_versions_are_filled_in(tmp_path):
    rows = rows_of().drop(columns=[*vars(CELL), *VERSIONS])
    write_cell(tmp_path, CELL, rows, {})
    found = load_record(folder=tmp_path)
    assert set(found["agent"]) == {CELL.agent}
    assert set(found["torch"]) == {""}


def test_rows_of_a_scenario_that_is_defined_otherwise_by_now_are_left_out(tmp_path):
    old = replace(CELL, scenario_digest="0123456789ab")
    write_cell(tmp_path, old, rows_of(old), {})
    found = read_record(folder=tmp_path)
    assert found.rows.empty
    why = "of a scenario that is defined otherwise by now"
    assert found.outdated == {("corridor_dense", "planner:gain=2"): why}


def test_rows_of_another_world_are_left_out(tmp_path):
    old = replace(CELL, world="0.0")
    write_cell(tmp_path, old, rows_of(old), {})
    found = read_record(folder=tmp_path)
    assert found.rows.empty
    (reason,) = found.outdated.values()
    assert reason == f"of world '0.0', and this crowdbench simulates world {WORLD_VERSION}"


def test_rows_that_0_1_0_has_stored_are_of_the_first_world(tmp_path):
    cell = replace(CELL, world="0.1")
    write_cell(tmp_path, cell, rows_of(cell), {})
    path = only_file(tmp_path, "rows")
    with gzip.open(path, "rt") as file:
        rows = pd.read_csv(file, dtype=str, keep_default_na=False)
    rows = rows.drop(columns="world").assign(version="0.1.0")
    path.write_bytes(gzip.compress(rows.to_csv(index=False).encode()))
    found = read_record(folder=tmp_path)
    assert bool(found.outdated) == (WORLD_VERSION != "0.1")
    assert set(found.rows["world"]) <= {"0.1"}


def test_commands_of_another_measurement_are_not_given_out(written):
    other = replace(CELL, weights_sha256="other")
    with pytest.warns(UserWarning, match=r"npz: commands of another measurement than the rows"):
        assert load_commands(other, written).of(7) == {}


def test_an_empty_record_has_no_rows(tmp_path):
    assert load_record(folder=tmp_path).empty
    assert load_commands(CELL, tmp_path).seeds == set()


@pytest.mark.parametrize(
    "content",
    [b"", b"no archive", gzip.compress(b"a,b\n1,2\n", mtime=0)],
    ids=["empty", "no archive", "no rows"],
)
def test_damaged_rows_are_named(written, content):
    path = only_file(written, "rows")
    path.write_bytes(content)
    with pytest.raises(ResultsError) as caught:
        load_record(folder=written)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda rows: pd.concat([rows, rows[2:3]]), "seed 99, robot_0 is there twice"),
        (lambda rows: rows.assign(scenario="unimodal_slow"), "they are of planner:gain=2 in unim"),
        (lambda rows: rows.assign(code=["a", *"bbbb"]), "they are of more than one measurement"),
        (lambda rows: rows.assign(seed=str(10**20)), "not rows of the record (Overflow"),
        (lambda rows: rows.assign(success=7.0), "seed 0, robot_0: success is 7.0, expected 0, 1"),
        (lambda rows: rows.assign(steps=-5), "seed 0, robot_0: steps is -5, expected 0 or more"),
        (lambda rows: rows.assign(outcome="draw"), "robot_0: outcome is draw, expected success"),
    ],
    ids=["twice", "elsewhere", "mixed", "seed", "success", "steps", "outcome"],
)
def test_rows_changed_by_hand_are_refused_and_never_counted(written, change, told):
    path = only_file(written, "rows")
    rows = pd.read_csv(path, keep_default_na=False, dtype=str)
    path.write_bytes(gzip.compress(change(rows).to_csv(index=False).encode()))
    with pytest.raises(ResultsError) as caught:
        load_record(folder=written)
    assert str(caught.value).startswith(f"{path}: ")
    assert told in str(caught.value)


def test_a_cut_off_file_of_commands_is_named(written):
    path = only_file(written, "actions")
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(ResultsError, match="not commands of the record") as caught:
        load_commands(CELL, written)
    assert str(path) in str(caught.value)


def test_commands_that_nobody_can_unpack_are_named(written):
    path = only_file(written, "actions")
    archive = bytearray(path.read_bytes())
    archive[archive.index(b"PK\x01\x02") + 10] = 99  # a method of compression that is not known
    path.write_bytes(archive)
    with pytest.raises(ResultsError, match=r"npz: not commands of the record \(That compression"):
        load_commands(CELL, written)


def test_pickles_are_refused(written):
    path = only_file(written, "actions")
    identity = np.array([object()], dtype=object)
    np.savez(path, identity=identity, seeds=identity, robots=identity, lengths=identity)
    with pytest.raises(ResultsError, match="not commands of the record"):
        load_commands(CELL, written)


def test_rows_that_do_not_belong_together_are_refused(tmp_path):
    rows = rows_of()
    with pytest.raises(ResultsError, match="another measurement"):
        write_cell(tmp_path, replace(CELL, weights_sha256="other"), rows, {})
    with pytest.raises(ResultsError, match="seed 7, robot_0 is there twice"):
        write_cell(tmp_path, CELL, pd.concat([rows, rows.iloc[1:2]]), {})
    with pytest.raises(ResultsError, match="without steps"):
        write_cell(tmp_path, CELL, rows.drop(columns="steps"), {})
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    "commands",
    [{(7, "robot_0"): np.zeros((4, 2))}, {(8, "robot_0"): np.zeros((3, 2))}],
    ids=["too many", "of no row"],
)
def test_commands_that_do_not_fit_the_rows_are_refused(tmp_path, commands):
    with pytest.raises(ResultsError, match=r"seed \d, robot_0: commands of shape"):
        write_cell(tmp_path, CELL, rows_of(), commands)


def test_a_folder_that_cannot_be_written_to_is_named(tmp_path):
    (tmp_path / "rows").write_text("in the way")
    with pytest.raises(ResultsError, match=f"{tmp_path}: the record cannot be written"):
        write_cell(tmp_path, CELL, rows_of(), {})
