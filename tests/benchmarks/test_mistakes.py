"""What benchmarks say of mistakes on their command lines."""

import importlib.util
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks"


@pytest.mark.parametrize(
    ("name", "arguments", "told"),
    [
        ("calibration", ["unimodal_slw"], "unknown scenario 'unimodal_slw'; did you mean 'unim"),
        ("calibration", ["unimodal_slow", "--agents", "orcaa"], "unknown agent 'orcaa'; did you m"),
        ("calibration", ["--episodes", "0"], "--episodes: 0; allowed: 1 or more"),
        ("calibration", ["--jobs", "-3"], "jobs: -3; allowed: 1 or more"),
        ("calibration", ["--folder", __file__], "test_mistakes.py"),
        ("crossing", ["nowhere", "--page", "none.md"], "--page: none.md: no such file"),
        ("simulation", ["hard_statoin"], "unknown scenario 'hard_statoin'; did you mean 'hard_st"),
        ("simulation", ["--peers", "/no/python"], "--peers: /no/python: no such program"),
        ("simulation", ["--peers", "false"], "--peers: false: no Python; see"),
        ("crossing", ["nowhere"], "'nowhere/juelich/bidirectional_corridor_400_b_03.txt': No such"),
        ("crossing", ["nowhere", "--episodes", "0"], "--episodes: 0; allowed: 1 or more"),
    ],
)
def test_a_mistake_ends_with_the_usage_and_one_line(
    name, arguments, told, tmp_path, monkeypatch, capsys
):
    spec = importlib.util.spec_from_file_location(f"{name}_benchmark", FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *arguments])
    with pytest.raises(SystemExit) as ended:
        module.main()
    assert ended.value.code == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith(f"{name}.py: error: ") and told in last
