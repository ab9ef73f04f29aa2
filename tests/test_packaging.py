"""A wheel built from the tree works in an environment of its own, away from the checkout."""

import json
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = {
    "crowdbench": "crowdbench",
    "agents": "crowdbench_agents",
    "scenarios": "crowdbench_scenarios",
    "results": "crowdbench_results",
    "studies": "crowdbench_studies",
}
INSTALLED_RESULTS = ("__init__.py", "record/rows/", "record/actions/")
"""What a wheel has of results/: no tables, figures or the commands of seeds from 100 on."""
LARGEST = 40_000_000
"""Bytes of a wheel."""
MAKE_AGENTS = """
import json
from crowdbench.agent import AgentError, AgentSpec, agent_names, find_agent
made = {}
for name in agent_names():
    find_agent(name)
    try:
        made[name] = AgentSpec.parse(name).make().weights_sha256
    except AgentError:
        made[name] = "cannot be made"
print(json.dumps(made))
"""
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def tree_files():
    """Every file of the packages under its installed name."""
    for folder, package in FOLDERS.items():
        for path in (ROOT / folder).rglob("*"):
            name = path.relative_to(ROOT / folder).as_posix()
            if not path.is_file() or "__pycache__" in path.parts:
                continue
            if folder != "results" or name.startswith(INSTALLED_RESULTS):
                yield f"{package}/{name}"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Built from a copy, so that leftovers of earlier builds in the checkout cannot help."""
    source, output = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for folder in FOLDERS:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / folder, source / folder, ignore=ignored)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "-o", output, source]
    subprocess.run(command, check=True, capture_output=True, cwd=output)
    return next(output.glob("*.whl"))


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """An environment that holds the wheel, and of the present one everything but crowdbench."""
    home = tmp_path_factory.mktemp("environment")
    venv.create(home, with_pip=False)
    paths = {"base": str(home), "platbase": str(home)}
    packages = Path(sysconfig.get_path("purelib", "venv", paths))
    command = [sys.executable, "-m", "pip", "--python", home, "install", "--no-deps", "--no-index"]
    subprocess.run([*command, "--quiet", wheel], check=True, capture_output=True)
    dependencies = home / "dependencies"
    dependencies.mkdir()
    for library in {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}:
        for entry in Path(library).iterdir():
            if "crowdbench" not in entry.name and not (dependencies / entry.name).exists():
                (dependencies / entry.name).symlink_to(entry)
    (packages / "dependencies.pth").write_text(f"{dependencies}\n")
    return home


@pytest.fixture
def run(installed, tmp_path):
    """Run a program of that environment in an empty folder; return what it prints."""

    def run(program, *arguments):
        command = [str(installed / "bin" / program), *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=300)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return run


def test_the_wheel_holds_every_file_of_the_tree_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as archive:
        shipped = {name for name in archive.namelist() if ".dist-info/" not in name}
        licenses = [name for name in archive.namelist() if name.endswith("licenses/LICENSE")]
    assert shipped == set(tree_files())
    assert len(licenses) == 1


def test_the_wheel_is_small_enough_to_be_installed_anywhere(wheel):
    assert wheel.stat().st_size <= LARGEST


def test_the_record_is_found_away_from_the_checkout(run):
    """All published rows, and of each cell the commands of those first seeds that have any."""
    script = """
from crowdbench.evaluation.joined import cells_of
from crowdbench.evaluation.record import INSTALLED_SEEDS, load_commands, load_record
rows = load_record()
commands = [load_commands(cell).seeds & {*INSTALLED_SEEDS} for cell in cells_of(rows).values()]
print(len(rows), len(commands), sum(map(len, commands)))
"""
    here = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    assert run("python", "-c", script).split() == here.stdout.decode().split()


def test_the_installed_packages_are_the_wheels(run, installed):
    modules = ", ".join(FOLDERS.values())
    where = run("python", "-c", f"import {modules}; print(*(m.__file__ for m in ({modules})))")
    assert all(Path(path).is_relative_to(installed) for path in where.split())


def test_the_main_command_runs(run, tmp_path):
    printed = run(
        "crowdbench", "run", "--scenario", "multimodal_fast", "--episodes", 1, "--jobs", 1
    )
    assert "multimodal_fast" in printed
    assert list(tmp_path.rglob("results.sqlite"))


def test_every_scenario_is_found(run):
    import crowdbench

    listed = run("crowdbench", "scenarios")
    assert [name for name in crowdbench.scenario_names() if name not in listed] == []
    names = run("python", "-c", "import crowdbench; print(*crowdbench.scenario_names())")
    assert names.split() == crowdbench.scenario_names()


def test_every_agent_is_found_with_its_weights(run):
    """Made from the wheel as from the tree: the same weights, or none published in either."""
    listed = run("crowdbench", "agents")
    agents = PROJECT["entry-points"]["crowdbench.agents"]
    assert [name for name in agents if name not in listed] == []
    made = json.loads(run("python", "-c", MAKE_AGENTS))
    here = subprocess.run([sys.executable, "-c", MAKE_AGENTS], capture_output=True, check=True)
    assert made == json.loads(here.stdout)
    assert sorted(made) == sorted(agents)
