"""Maps as images: what is dark is solid where map_server would say so, and nothing else."""

from __future__ import annotations

import re

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from crowdbench.scenario import ScenarioError, load_scenario
from crowdbench.scenario.images import outlines_of, read_map

ROOM = np.full((60, 100), 254, dtype=np.uint8)  # 3 m x 5 m at 5 cm
ROOM[[0, -1]] = ROOM[:, [0, -1]] = 0
ROOM[:40, 50] = 0  # a wall from the top, a pixel thick
REGIONS = {"a": [0.2, 0.2, 1, 1], "b": [4, 0.5, 4.8, 1.5]}


def write_map(folder, pixels=ROOM, **fields):
    """Write a map's files; fields with the value None are left out."""
    Image.fromarray(pixels).save(folder / "room.pgm")
    text = {"image": "room.pgm", "resolution": 0.05, "origin": [0.0, 0.0, 0.0], "negate": 0}
    text |= {"occupied_thresh": 0.65, "free_thresh": 0.196, **fields}
    lines = [f"{key}: {value}" for key, value in text.items() if value is not None]
    path = folder / "room.yaml"
    path.write_text("\n".join(lines))
    return path


def scenario_of(path, **changes):
    arena = {"kind": "map", "image": str(path), "regions": REGIONS}
    robots = {"start": "a", "goal": "b"}
    return load_scenario("multimodal_fast", arena=arena, robots=robots, **changes)


def solid(outlines):
    return shapely.union_all([shapely.Polygon(outline) for outline in outlines])


def test_size_and_place_come_from_the_image(tmp_path):
    found = read_map(write_map(tmp_path, origin=[-1.0, 2.0, 0.0]))
    assert (found["length"], found["width"], found["centre"]) == (5.0, 3.0, (1.5, 3.5))
    x, y, right, top = solid(found["polygons"]).bounds
    assert (x, y, right, top) == (-1.0, 2.0, 4.0, 5.0)


def test_rows_of_a_picture_begin_at_the_top(tmp_path):
    walls = solid(read_map(write_map(tmp_path))["polygons"])
    assert walls.contains(shapely.Point(2.525, 2.5))
    assert not walls.intersects(shapely.Point(2.525, 0.5))
    assert walls.area == pytest.approx(0.05**2 * np.count_nonzero(ROOM == 0))


# GEOS's simplify moves the outline of this picture by more than it was allowed to.
NOTCHED = np.ones((8, 4), dtype=np.bool_)
NOTCHED[2, 0] = NOTCHED[3, :2] = False


@settings(max_examples=60, deadline=None)
@given(arrays(np.bool_, st.tuples(st.integers(1, 12), st.integers(1, 12))))
@example(NOTCHED)
def test_outlines_are_simple_and_within_a_pixel_of_what_is_solid(pixels):
    outlines = [np.round(0.05 * outline, 6) / 0.05 for outline in outlines_of(pixels)]
    assert all(shapely.Polygon(outline).is_valid for outline in outlines)
    covered = solid(outlines)
    y, x = np.nonzero(pixels)
    exact = shapely.union_all(shapely.box(x, y, x + 1, y + 1))
    assert exact.difference(covered.buffer(1)).area < 1e-6
    assert covered.difference(exact.buffer(1)).area < 1e-6


def test_a_diagonal_line_of_pixels_is_one_wall():
    (outline,) = outlines_of(np.eye(20, dtype=np.bool_))
    line = shapely.LineString([(0, 20), (20, 0)])
    assert shapely.Polygon(outline).intersects(line)
    assert len(outline) < 8


@pytest.mark.parametrize(
    ("value", "negate", "threshold", "is_solid"),
    [
        # p = (255 - x) / 255, or x / 255 where negated, is solid above the threshold.
        (0, 0, 0.65, True),
        (254, 0, 0.65, False),
        (205, 0, 0.65, False),  # unknown
        (205, 0, 0.19, True),
        (89, 0, 0.65, True),  # p = 0.651
        (90, 0, 0.65, False),  # p = 0.647
        (254, 1, 0.65, True),
        (0, 1, 0.65, False),
    ],
)
def test_thresholds_are_map_servers(tmp_path, value, negate, threshold, is_solid):
    pixels = np.full((10, 10), 255 if negate == 0 else 0, dtype=np.uint8)
    pixels[4:6, 4:6] = value
    path = write_map(tmp_path, pixels, negate=negate, occupied_thresh=threshold)
    assert bool(read_map(path)["polygons"]) is is_solid


def test_a_scenario_counts_by_what_its_image_shows_and_needs_it_no_more(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    first = scenario_of(write_map(tmp_path))
    other = scenario_of(write_map(tmp_path / "elsewhere", occupied_thresh=0.5))
    assert first.digest == other.digest
    assert first.arena.image is None
    changed = ROOM.copy()
    changed[30, 20] = 0
    assert scenario_of(write_map(tmp_path, changed)).digest != first.digest
    (tmp_path / "room.pgm").unlink()
    assert first.override({"pedestrians.count": 2}).arena == first.arena


def test_an_image_is_not_laid_over_another_map_unsaid(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    room = scenario_of(write_map(tmp_path))
    empty = write_map(tmp_path / "elsewhere", np.full_like(ROOM, 255))
    told = r"arena\.image: .*room\.yaml' for a map that has arena\.polygons already; allowed: with"
    for changes in ({"arena.image": str(empty)}, {"arena": {"image": str(empty)}}):
        with pytest.raises(ScenarioError, match=told):
            room.override(changes)
    other = room.override({"arena.image": str(empty), "arena.polygons": []})
    assert not other.arena.polygons
    assert other.override({"arena.image": str(tmp_path / "room.yaml")}).digest == room.digest


def test_on_whatever_an_image_is_set_what_stays_of_that_map_is_said(tmp_path):
    image = write_map(tmp_path)
    (walled := tmp_path / "walled.yaml").write_text(
        "extends: multimodal_fast\nrobots: {start: a, goal: b}\n"
        "arena: {kind: map, length: 5, width: 3, centre: [2.5, 1.5], walls: [[2, 1, 3, 1]],\n"
        f"  polygons: [[[3, 2], [3.1, 2], [3, 2.1]]], regions: {REGIONS}}}\n"
    )
    (mine := tmp_path / "mine.yaml").write_text(
        "extends: walled.yaml\narena: {image: room.yaml, polygons: []}\n"
    )
    both = r"for a map that has arena\.polygons and arena\.walls already; allowed: with arena\.pol"
    changes = {"arena.image": str(image)}
    for refused in (
        lambda: load_scenario(walled, **changes),
        lambda: load_scenario(load_scenario(walled), **changes),
        lambda: load_scenario(walled).override({"arena": {"image": str(image)}}),
    ):
        with pytest.raises(ScenarioError, match=r"arena\.image: .*room\.yaml' " + both):
            refused()
    with pytest.raises(ScenarioError, match=r"mine\.yaml.*that has arena\.walls already; allowed"):
        load_scenario(mine)
    changes |= {"arena.polygons": [], "arena.walls": [[2, 1, 3, 1]]}
    shown = load_scenario(walled, **changes)
    assert shown.arena.polygons == scenario_of(image).arena.polygons
    assert shown.arena.walls == load_scenario(walled).arena.walls
    mine.write_text("extends: walled.yaml\narena: {image: room.yaml, polygons: [], walls: []}\n")
    assert load_scenario(mine).arena == scenario_of(image).arena


def test_the_image_is_found_beside_the_file_that_names_it(tmp_path, monkeypatch):
    write_map(tmp_path)
    robots = "robots: {start: [0.5, 0.5], goal: [4, 1]}"
    text = f"extends: multimodal_fast\narena: {{kind: map, image: room.yaml}}\n{robots}\n"
    (tmp_path / "station.yaml").write_text(text)
    monkeypatch.chdir("/")
    assert load_scenario(tmp_path / "station.yaml").arena.length == 5.0


@pytest.mark.parametrize(("field", "value"), [("length", 99), ("width", 5), ("centre", [0, 0])])
def test_what_the_image_says_is_not_said_beside_it(tmp_path, field, value):
    told = rf"': arena\.{field}: {re.escape(str(value))}; the image decides it; allowed with arena"
    path = write_map(tmp_path)
    station, mine = tmp_path / "station.yaml", tmp_path / "mine.yaml"
    text = "extends: multimodal_fast\nrobots: {start: [0.5, 0.5], goal: [4, 1]}\n"
    arena = "arena: {kind: map, image: room.yaml"
    station.write_text(f"{text}{arena}, {field}: {value}}}\n")
    with pytest.raises(ScenarioError, match="station.yaml" + told):
        load_scenario(station)
    station.write_text(f"{text}{arena}}}\n")  # beside a size that is inherited
    mine.write_text(f"extends: station.yaml\narena: {{{field}: {value}}}\n")
    with pytest.raises(ScenarioError, match="mine.yaml" + told):
        load_scenario(mine)
    with pytest.raises(ScenarioError, match="station.yaml" + told):
        load_scenario(station, **{f"arena.{field}": value})
    with pytest.raises(ScenarioError, match="multimodal_fast" + told):
        scenario_of(path, **{f"arena.{field}": value})
    whole = load_scenario(station)
    assert load_scenario("unimodal_slow", **whole.model_dump()) == whole


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"resolution": None}, "room.yaml: resolution is missing; allowed: a number, 0.001 to 10"),
        ({"resolution": 0}, "resolution: 0; allowed: 0.001 to 10"),
        ({"resolution": "5cm"}, "resolution: '5cm'; allowed"),
        ({"resolution": 5}, "500 x 300 m are too large; allowed: 200 m a side"),
        ({"occupied_thresh": 65}, "occupied_thresh: 65; allowed: 0 to 1"),
        ({"origin": [0, 0, 0.5]}, "origin: [0, 0, 0.5]; allowed: [x, y, yaw]"),
        ({"origin": 3}, "origin: 3; allowed"),
        ({"origin": '"12"'}, "origin: '12'; allowed"),
        ({"origin": ["1", "2", "0"]}, "origin: ['1', '2', '0']; allowed"),
        ({"origin": "[true, false, 0]"}, "origin: [true, false, 0]; allowed"),
        ({"origin": [0, 0]}, "origin: [0, 0]; allowed"),
        ({"origin": [0, 0, 0, 0]}, "origin: [0, 0, 0, 0]; allowed"),
        ({"origin": "[.nan, 0, 0]"}, "origin: [nan, 0, 0]; allowed"),
        ({"origin": [10**400, 0, 0]}, "origin: [a number of 1329 bits, 0, 0]; allowed"),
        ({"resolution": '"0.05"'}, "resolution: '0.05'; allowed"),
        ({"negate": '"1"'}, "negate: '1'; allowed"),
        ({"image": None}, "image: null; allowed: the name of a PGM or PNG file"),
        ({"image": "none.pgm"}, "none.pgm does not exist; allowed: a PGM or PNG file"),
        ({"image": "room.yaml"}, "room.yaml cannot be read as a picture"),
        ({"mode": "raw"}, "room.yaml: mode: 'raw'; allowed: trinary or scale"),
        ({"mode": ["raw"]}, "mode: ['raw']; allowed"),
        ({"negate": "[1"}, "not a YAML file (line"),
    ],
)
def test_what_a_map_cannot_be_read_from_is_said(tmp_path, fields, told):
    with pytest.raises(ScenarioError, match=r"^scenario .*: arena\.image: ") as caught:
        scenario_of(write_map(tmp_path, **fields))
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_picture_that_is_too_large_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench.scenario.images.MOST_PIXELS", 5_999)
    with pytest.raises(ValueError, match=re.escape("100 x 60 pixels, which is too large")):
        read_map(write_map(tmp_path))


def test_a_file_cut_short_is_no_picture(tmp_path):
    path = write_map(tmp_path)
    (tmp_path / "room.pgm").write_bytes((tmp_path / "room.pgm").read_bytes()[:50])
    with pytest.raises(ValueError, match="cannot be read as a picture"):
        read_map(path)


def test_a_missing_map_is_said_and_only_a_map_has_one(tmp_path):
    with pytest.raises(ScenarioError, match=r"arena\.image: .*none.yaml does not exist"):
        scenario_of(tmp_path / "none.yaml")
    path = write_map(tmp_path)
    with pytest.raises(ScenarioError, match=r"arena\.image: .*; allowed: with arena\.kind map"):
        load_scenario("multimodal_fast", arena={"image": str(path)})
