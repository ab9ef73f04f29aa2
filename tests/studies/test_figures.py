from __future__ import annotations

import contextlib
import itertools
import shutil
import sqlite3

import matplotlib as mpl
import numpy as np
import pytest
from crowdbench_studies.paper import STUDY, scenes
from crowdbench_studies.paper.charts import reactivity, read_curve
from crowdbench_studies.paper.figures import DRAWINGS
from crowdbench_studies.paper.plan import COMPARED, NONREACTIVE, REACTIVE, STORY
from crowdbench_studies.paper.style import STYLES
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from crowdbench.evaluation.database import FILE, ResultsError
from crowdbench.evaluation.driven import packed
from crowdbench.evaluation.rollout import run_episode
from crowdbench.evaluation.scene import arena_picture
from crowdbench.scenario import load_scenario
from crowdbench.study.figures import save_figures
from crowdbench.study.measurements import Measurements
from crowdbench.study.style import LOOK, WIDTH, styles

NAMES = [drawing.name for drawing in DRAWINGS]


@pytest.fixture(scope="module")
def folder(many, tmp_path_factory):
    """Everything that figures are made of: episodes, whole runs and training curves."""
    target = tmp_path_factory.mktemp("figures")
    shutil.copytree(many.folder, target, dirs_exist_ok=True)
    (target / "training").mkdir()
    for number, agent in enumerate(("sac", "tdmpc", "latent_planner")):
        steps = np.linspace(0, 1.3e6, 40)
        rows = [f"{s:.0f},{s / (60 + number):.1f},{1 - np.exp(-s / 4e5):.4f},x" for s in steps]
        text = "\n".join(["steps,seconds,success,more", *rows, ""])
        (target / "training" / f"{agent}.csv").write_text(text)
    scenario, agent, seeds = STORY
    runs = (run_episode(scenario, "straight_line", seed)[0] for seed in range(seeds))
    episode = next(run for run in runs if run.outcome == "success")
    with contextlib.closing(sqlite3.connect(target / FILE)) as database, database:
        query = """
            UPDATE episodes SET steps = ?, outcome = 'success' WHERE seed = ? AND cell =
            (SELECT id FROM cells WHERE scenario = ? AND agent = ?) RETURNING id"""
        facts = (episode.steps, episode.seed, scenario, agent)
        (number,) = database.execute(query, facts).fetchone()
        actions = (number, *packed(episode.commands, episode.inference_s))
        database.execute("INSERT INTO actions VALUES (?, ?, ?)", actions)
    return target


@pytest.fixture(scope="module")
def measured(folder):
    return Measurements.load(folder, STUDY.cells())


@pytest.fixture
def drawn(folder, measured, monkeypatch):
    """Draw a figure; returns it with the texts that were really painted."""

    def draw(name):
        drawing = next(drawing for drawing in DRAWINGS if drawing.name == name)
        painted, paint = [], Text.draw

        def record(self, *arguments):
            if self.get_visible() and self.get_text().strip():
                painted.append(self)
            return paint(self, *arguments)

        monkeypatch.setattr(Text, "draw", record)
        with mpl.rc_context(LOOK):
            figure = drawing.draw(measured, folder)
            FigureCanvasAgg(figure)
            figure.canvas.draw()
        return figure, list(dict.fromkeys(painted))

    return draw


@pytest.mark.parametrize("name", NAMES)
def test_no_text_overlaps_another_or_leaves_the_page(drawn, name):
    figure, texts = drawn(name)
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts]
    assert len(boxes) > 5
    for (one, a), (other, b) in itertools.combinations(boxes, 2):
        across = min(a.x1, b.x1) - max(a.x0, b.x0)
        up = min(a.y1, b.y1) - max(a.y0, b.y0)
        assert across <= 0.5 or up <= 0.5, f"{one!r} overlaps {other!r}"
    for text, box in boxes:
        assert box.x0 >= -1 and box.x1 <= figure.bbox.x1 + 1, text
        assert box.y0 >= -1 and box.y1 <= figure.bbox.y1 + 1, text


@pytest.mark.parametrize("name", NAMES)
def test_figures_are_one_column_wide_and_readable_in_print(drawn, name):
    figure, texts = drawn(name)
    assert figure.get_size_inches()[0] == WIDTH == 3.5
    assert figure.get_size_inches()[1] <= 6
    assert min(text.get_fontsize() for text in texts) >= 7  # pt


@pytest.mark.parametrize(
    ("name", "labels"),
    [
        ("figure_3_scene", {"x [m]", "y [m]"}),
        (
            "figure_4_corridors",
            {"Success", "SPL", "Corridor: static obstacles + people"},
        ),
        (
            "figure_5_training",
            {"Validation success", "Environment steps [10$^6$]", "Wall time [h]"},
        ),
        ("figure_6_run", {"x [m]", "y [m]"}),
        ("figure_reactivity", {"Success lost when not seen"}),
    ],
)
def test_axes_say_what_they_show(drawn, name, labels):
    _, texts = drawn(name)
    assert labels <= {text.get_text() for text in texts}


def test_methods_differ_by_more_than_their_colour():
    assert {method.agent for method in COMPARED} == set(STYLES)
    styles = list(STYLES.values())
    shapes = [(style.marker, str(style.line)) for style in styles]
    assert len(set(shapes)) == len(shapes)
    markers = [style.marker for style in styles if style.marker]
    assert len(set(markers)) == len(markers)


def test_corridor_figure_shows_the_means_of_the_tables(drawn, measured):
    figure, _ = drawn("figure_4_corridors")
    top = figure.axes[0]
    containers = {c.get_label(): c for c in top.containers}
    for method in COMPARED:
        line = containers[method.label].lines[0]
        means = [
            measured.mean(method.agent, (name,), "success").mean
            for name in ("corridor_sparse", "corridor_moderate", "corridor_dense")
        ]
        assert list(line.get_ydata())[:3] == means


def test_the_loss_is_reactive_less_non_reactive(episodes):
    """Two thirds of the seeds arrive among people who react, one third among those who do not."""
    for name in REACTIVE:
        episodes.add("orca", name, success=[1, 1, 0] * 10)
    for name in NONREACTIVE:
        episodes.add("orca", name, success=[1, 0, 0] * 10)
    figure = reactivity(episodes.measured())
    (axis,) = figure.axes
    pooled = next(c for c in axis.containers if c.get_label() == "All four")
    assert pooled.lines[0].get_xdata()[0] == pytest.approx(1 / 3)
    assert [label.get_text() for label in axis.get_yticklabels()] == ["ORCA"]


def test_the_snapshots_end_where_the_run_ends_or_before(measured):
    (episode,) = scenes._stories(measured)
    steps = scenes._moments(episode)
    assert len(steps) == 4
    assert list(steps) == sorted(set(steps))
    assert steps[0] >= 0 and steps[-1] <= episode.steps


def test_the_scene_is_shown_without_the_renderer_s_margin():
    scenario = load_scenario("corridor_very_dense")
    picture = arena_picture(scenario, seed=2, steps=1)
    height, width = picture.shape[:2]
    assert width / height == pytest.approx(scenario.arena.length / scenario.arena.width, rel=0.01)
    # The walls are the dark lines on the long sides: the arena fills the picture.
    assert picture[0].mean() < 130 and picture[-1].mean() < 130


def test_the_same_data_give_the_same_bytes(folder, measured, tmp_path):
    for name in ("one", "two"):
        assert all(save_figures(DRAWINGS, measured, folder, tmp_path / name).values())
    files = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert files == sorted(f"{name}.{ending}" for name in NAMES for ending in ("pdf", "png"))
    for file in files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


def test_a_figure_without_data_is_left_out_and_an_old_one_removed(tmp_path):
    old = tmp_path / "figure_4_corridors.png"
    old.write_bytes(b"old")
    there = save_figures(DRAWINGS, Measurements.load(tmp_path, STUDY.cells()), tmp_path, tmp_path)
    assert there == {name: name == "figure_3_scene" for name in NAMES}
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "figure_3_scene.pdf",
        "figure_3_scene.png",
    ]


def test_a_curve_is_read_with_its_units(folder):
    curve = read_curve(folder / "training" / "sac.csv")
    assert curve.shape == (40, 3)
    assert curve[-1] == pytest.approx([1.3e6, 1.3e6 / 60, 1 - np.exp(-1.3e6 / 4e5)], abs=1)
    assert read_curve(folder / "training" / "nobody.csv").shape == (0, 3)


@pytest.mark.parametrize("text", ["steps,success\n1,2\n", "steps,seconds,success\n1,2,high\n"])
def test_a_curve_that_is_none_is_refused_by_name(tmp_path, text):
    path = tmp_path / "sac.csv"
    path.write_text(text)
    with pytest.raises(ResultsError, match=r"sac\.csv: expected numbers in columns steps"):
        read_curve(path)


def test_a_method_without_a_style_of_its_own_gets_one_that_nothing_else_has():
    found = styles(["mine", *STYLES, "yours"], STYLES)
    assert {agent: found[agent] for agent in STYLES} == STYLES
    looks = [(style.color, style.marker) for style in found.values() if style.marker]
    assert len(looks) == len(set(looks))
