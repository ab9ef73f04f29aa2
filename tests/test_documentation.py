"""What the pages tell a reader to write and run works as written, page by page, top to bottom."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from pages import ROOT, unpack

import crowdbench

PAGES = [
    "README.md",
    "docs/tutorial.md",
    "docs/add_an_agent.md",
    "docs/add_a_metric.md",
    "docs/write_a_scenario.md",
    "docs/maps.md",
    "docs/add_a_drive.md",
    "docs/pedestrians_as_agents.md",
    "docs/people.md",
    "docs/reproduce_the_tables.md",
    "docs/write_a_study.md",
    *(
        pytest.param(f"docs/{name}.md", marks=pytest.mark.slow)
        for name in (
            "train_with_your_library",
            "stable_baselines3",
            "onnx",
            "minari",
            "add_a_walking_model",
            "several_robots",
            "clusters",
            "benchmarl",
            "rllib",
        )
    ),
]


def run(command, folder):
    """Run in a folder where everything relative in the page comes to lie."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {
        "PATH": path,
        "PYTHONPATH": str(folder),
        "MINARI_DATASETS_PATH": str(folder / "datasets"),
    }
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"


@pytest.mark.parametrize("page", PAGES)
def test_a_page_works_from_top_to_bottom(page, tmp_path):
    """Code that begins with a file's name is saved under it, all other code is run.

    Blocks that install are left out, since that is tested elsewhere; what ``pip`` would note of
    entry points is written beside the files.
    """
    ran = 0
    for language, code in unpack(page, tmp_path):
        if language == "python":
            run([sys.executable, "-c", code], tmp_path)
            ran += 1
        elif language == "bash" and "pip install" not in code:
            run(["bash", "-e", "-c", code], tmp_path)
            ran += 1
    assert ran > 0


def test_links_lead_somewhere():
    pages = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("agents/**/*.md")]
    dead = [
        f"{page.relative_to(ROOT)}: {target}"
        for page in pages
        for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text())
        if "://" not in target and not (page.parent / target).exists()
    ]
    assert dead == []


def test_the_readme_lists_every_agent():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    agents = sorted(project["entry-points"]["crowdbench.agents"])
    rows = re.findall(r"^\| `(\w+)` \|", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert sorted(rows) == agents


def test_the_reference_has_every_public_name():
    listed = re.findall(r":: crowdbench\.(\w+)", (ROOT / "docs/api.rst").read_text())
    assert sorted(listed) == sorted(crowdbench.__all__)


def test_the_reference_has_every_agent():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    classes = {
        path.replace(":", ".") for path in project["entry-points"]["crowdbench.agents"].values()
    }
    listed = re.findall(r"autoclass:: (\S+)", (ROOT / "docs/agents.rst").read_text())
    assert set(listed) == classes
