"""Maps in a scenario file: what is taken, what is refused, and in which words."""

from __future__ import annotations

import pytest
import yaml
from map_scenarios import HALL, hall

from crowdbench.scenario import Scenario, ScenarioError, load_scenario
from crowdbench.simulation.layout import place


def test_a_map_survives_json_and_its_digest_holds_every_part_of_it():
    scenario = hall()
    assert Scenario.model_validate_json(scenario.model_dump_json()) == scenario
    moved = [
        {"arena__walls": [[0, 0, 1, 1]]},
        {"arena__polygons": []},
        {"arena__regions": {**HALL["arena.regions"], "more": [0, 0, 1, 1]}},
        {"robots__goal": [8, 0]},
        {"robots__look_ahead": 2.0},
    ]
    assert len({scenario.digest, *(hall(**change).digest for change in moved)}) == 6


def test_a_polygon_may_repeat_its_first_corner():
    ring = [[0, 0], [1, 0], [0, 1]]
    assert hall(arena__polygons=[[*ring, ring[0]]]) == hall(arena__polygons=[ring])


def test_a_region_can_be_changed_by_itself():
    regions = hall(arena__regions__west=[[-9, 0], [-8, 1], [-8, 0]]).arena.regions
    assert regions == {"west": ((-9, 0), (-8, 1), (-8, 0)), "east": (7, -5, 9, 5)}


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("arena__walls", [[0, 0, 1, 0], [1, 2, 3]], "wall 2 is [1, 2, 3]; allowed: four numbers"),
        ("arena__walls", [[1, 2, 1, 2]], "its two ends apart"),
        ("arena__walls", [[0, 0, 1e5, 0]], "wall 1 is"),
        ("arena__polygons", [[[0, 0], [1, 1]]], "polygon 1 is open, a line of 2 points; allowed"),
        (
            "arena__polygons",
            [[[0, 0], [1, 1], [1, 0], [0, 1]]],
            "polygon 1 crosses or touches itself at (0.5, 0.5)",
        ),
        ("arena__polygons", [[[0, 0], [1, 1], [2, 2]]], "polygon 1 crosses or touches itself"),
        ("arena__polygons", [[[0, 0], [1, "a"], [2, 2]]], "allowed: a list of corners [x, y]"),
        (
            "arena__walls",
            [[0, 0, 0, k + 1] for k in range(2001)],
            "2,017 edges with arena.walls; allowed: 2,000",
        ),
        ("arena__regions", [1], "allowed: a section of `name: [x_min"),
        ("arena__regions", {"w e": [0, 0, 1, 1]}, "the name 'w e'; allowed: 1 to 100 letters"),
        ("arena__regions__west", [1, 1, 0, 0], "west is [1, 1, 0, 0]; allowed: [x_min, y_min"),
        ("arena__regions__west", [-9, -5, -7], "allowed: a rectangle"),
        ("arena__regions__west", [[0, 0], [1, 1]], "west is open"),
        (
            "arena__regions__west",
            [-11, -5, -7, 5],
            "(-11, -5) lies outside the area; allowed: x from -10 to 10 and y from -6 to 6 m",
        ),
        ("robots__start", "wset", "unknown region 'wset'; did you mean 'west'?"),
        ("robots__start", [0, 0, 0], "allowed: the name of a region of arena.regions, a point"),
        ("robots__start", [11, 0], "(11, 0) lies outside the area; allowed"),
        ("robots__start", None, "null; allowed on a map: a region"),
        ("robots__goal", "west", "'west' is robots.start too; allowed: another region"),
        (
            "robots",
            {"start": [-5, 0], "goal": [-5, 0.01]},
            "robots.goal: (-5, 0.01) is 0.01 m from robots.start; allowed: more than 0.8 m (by",
        ),
        ("robots__look_ahead", 0, "robots.look_ahead: 0 is out of range; allowed: >= 0.001"),
        ("arena__centre", [1], "[1] is no point; allowed: two numbers [x, y]"),
    ],
)
def test_what_a_map_cannot_be_is_said_with_the_field_and_what_is_allowed(field, value, told):
    with pytest.raises(ScenarioError) as caught:
        hall(**{field: value})
    message = str(caught.value)
    assert told in message
    assert "\n" not in message
    assert "allowed" in message or "did you mean" in message
    section = field.replace("__", ".").removesuffix(".west")
    assert section in message or "arena.polygons" in message


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"arena.walls": [[0, 0, 1, 1]]}, "arena.walls: arena.kind is 'open'; allowed: with"),
        ({"arena.polygons": [[[0, 0], [1, 0], [0, 1]]]}, "arena.polygons: arena.kind is 'open'"),
        ({"arena.centre": [1, 0]}, "arena.centre: arena.kind is 'open'; allowed: with arena.kind"),
        ({"robots.start": [0, 0]}, "robots.goal: null; allowed: robots.start and robots.goal"),
        ({"robots.goal": [0, 0]}, "robots.start: null; allowed: robots.start and robots.goal"),
        ({"robots.start": "west"}, "unknown region 'west'; arena.regions has none"),
        (
            {"robots.start": [0, 0], "robots.goal": [3, 0], "robots.count": 2},
            "robots.start: a point for 2 robots; allowed: a region",
        ),
    ],
)
def test_arenas_that_are_no_map_say_what_only_a_map_has(changes, told):
    with pytest.raises(ScenarioError) as caught:
        load_scenario("multimodal_fast", **changes)
    assert told in str(caught.value)


def test_a_point_may_be_as_near_as_messages_say():
    """The circle around 0.4 x 0.3 m is 0.5 m wide, and the goal reached at 0.3 m."""
    assert place(hall(robots={"start": [-5, 0], "goal": [-5, 0.801]}), 900_000).robot_pose.any()
    with pytest.raises(ScenarioError, match=r"robots.goal: .* allowed: more than 0\.8 m"):
        hall(robots={"start": [-5, 0], "goal": [-5, 0.8]})
    queue = [{"head": [4, 0], "count": 2, "direction": 180}]  # the second one at (4.8, 0)
    people = {"count": 4, "radius": 0.2, "spawn_clearance": 1, "queues": queue}
    assert place(hall(robots__goal=[6.251, 0], pedestrians=people), 900_000).robot_goal.any()
    told = r"robots\.goal: \(6\.249, 0\) is 1\.449 m from place 2 of queue 1 .* more than 1\.45 m"
    with pytest.raises(ScenarioError, match=told):
        hall(robots__goal=[6.249, 0], pedestrians=people)
    with pytest.raises(ScenarioError, match=r"robots\.start: \(4, 0\) is 0 m from place 1 of"):
        hall(robots__start=[4, 0], pedestrians=people)


def test_a_file_says_it_as_yaml(tmp_path):
    arena = {key.removeprefix("arena."): HALL[key] for key in HALL if key.startswith("arena.")}
    robots = {"start": "west", "goal": "east"}
    document = {"extends": "multimodal_fast", "name": "hall", "arena": arena, "robots": robots}
    path = tmp_path / "hall.yaml"
    path.write_text(yaml.safe_dump(document))
    assert load_scenario(path).digest == hall().digest
