"""Digests survive fields to come: published episodes are stored under those of today."""

from __future__ import annotations

import pytest
from pydantic import BaseModel

from crowdbench.scenario import (
    Arena,
    Odometry,
    Scenario,
    later,
    load_scenario,
    scenario_names,
)
from crowdbench.scenario.habits import Attention, Groups, Stops
from crowdbench.scenario.recorded import Recording

DIGESTS = {
    "unimodal_slow": "3690941ae711",
    "unimodal_fast": "4b34bda258ca",
    "multimodal_slow": "7687eb5981dd",
    "multimodal_fast": "01530657c369",
    "unimodal_slow_nonreactive": "607c55704203",
    "unimodal_fast_nonreactive": "256703d7ee97",
    "multimodal_slow_nonreactive": "4036b5c972d0",
    "multimodal_fast_nonreactive": "239470b960f5",
    "corridor_sparse": "7818f9f9bedb",
    "corridor_moderate": "1e2fe5c58508",
    "corridor_dense": "b586e2176a23",
    "corridor_very_dense": "df19c1e3580a",
}

FIRST_FIELDS = {
    "": "name description control_period substeps time_limit",
    "arena.": "kind length width",
    "robots.": "count length width speed turn_rate acceleration travel goal_tolerance",
    "lidar.": "beams field_of_view range noise dropout",
    "obstacles.": "count radius",
    "pedestrians.": "count radius speed model control reactive field_of_view responsibility goals"
    " switch_probability leg on_arrival spawn_clearance",
    "reward.": "arrival progress collision proximity proximity_range social social_radius"
    " social_horizon",
}
"""Those of 0.1.0, which every digest holds. Nothing is ever added here."""

LATER_FIELDS: dict[str, object] = {
    "arena.walls": (),
    "arena.polygons": (),
    "arena.image": None,
    "arena.regions": {},
    "arena.centre": (0.0, 0.0),
    "robots.start": None,
    "robots.goal": None,
    "robots.look_ahead": 3.0,
    "robots.drive": "differential",
    "robots.lateral_speed": (-1.0, 1.0),
    "pedestrians.speed_mean": None,
    "pedestrians.speed_deviation": None,
    "pedestrians.acceleration": None,
    "pedestrians.attention": Attention(),
    "pedestrians.attention.away_share": 0.0,
    "pedestrians.attention.away_for": (2.0, 5.0),
    "pedestrians.attention.every": (5.0, 10.0),
    "pedestrians.stops": Stops(),
    "pedestrians.stops.share": 0.0,
    "pedestrians.stops.duration": (2.0, 5.0),
    "pedestrians.standing": 0.0,
    "pedestrians.queues": (),
    "pedestrians.groups": Groups(),
    "pedestrians.groups.share": 0.0,
    "pedestrians.groups.size": (2, 4),
    "pedestrians.recording": Recording(),
    "pedestrians.recording.file": "",
    "pedestrians.recording.unit": None,
    "pedestrians.recording.fps": None,
    "pedestrians.recording.route": "across",
    "pedestrians.recording.sha256": "",
    "robots.latency": 0,
    "robots.odometry": Odometry(),
    "robots.odometry.rotation": 0.0,
    "robots.odometry.rotation_by_translation": 0.0,
    "robots.odometry.translation": 0.0,
    "robots.odometry.translation_by_rotation": 0.0,
    "lidar.mount": (0.0, 0.0, 0.0),
    "pedestrians.leg_from": "position",
    "pedestrians.streams": (),
}
"""Those declared with ``later`` and their defaults, which never change."""


def first_fields() -> set[str]:
    return {prefix + name for prefix, names in FIRST_FIELDS.items() for name in names.split()}


def test_the_tables_scenarios_keep_their_digests():
    assert {name: load_scenario(name).digest for name in DIGESTS} == DIGESTS
    assert set(scenario_names()) >= set(DIGESTS)


def fields(section, prefix=""):
    """Every field by its dotted name; a section that came later is one itself."""
    for name, field in section.model_fields.items():
        nested = isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel)
        if not nested or "since" in (field.json_schema_extra or {}):
            yield prefix + name, field
        if nested:
            yield from fields(field.annotation, f"{prefix}{name}.")


def test_every_field_is_one_of_0_1_0_or_declared_as_a_later_one():
    declared = dict(fields(Scenario))
    marked = {
        name: field.get_default(call_default_factory=True)
        for name, field in declared.items()
        if "since" in (field.json_schema_extra or {})
    }
    assert set(declared) - set(marked) == first_fields()
    assert marked == LATER_FIELDS


class Ground(BaseModel, frozen=True):
    slope: float = later(0.0, since="0.3")
    grip: float = later(1.0, since="0.4")


class LaterArena(Arena):
    floors: tuple[float, float] = later([1, 2], since="0.2")


class LaterScenario(Scenario):
    arena: LaterArena = LaterArena()
    gravity: float = later(9.81, since="0.2", gt=0)
    ground: Ground = later(Ground(), since="0.3")


def test_later_fields_are_found_as_such():
    added = set(dict(fields(LaterScenario))) - first_fields() - set(LATER_FIELDS)
    assert added == {"arena.floors", "gravity", "ground", "ground.slope", "ground.grip"}


def of_tomorrow(name, **changes) -> LaterScenario:
    """A scenario with some sections or fields changed, read by a later version."""
    document = load_scenario(name).model_dump()
    for key, value in changes.items():
        document[key] = {**document.get(key, {}), **value} if isinstance(value, dict) else value
    return LaterScenario.model_validate(document)


@pytest.mark.parametrize("name", DIGESTS)
def test_a_later_field_at_its_default_leaves_the_digest_as_it_was(name):
    assert of_tomorrow(name).digest == DIGESTS[name]


def test_a_later_field_with_another_value_changes_the_digest():
    changes = [{}, {"gravity": 1.62}, {"arena": {"floors": (1, 3)}}, {"ground": {"slope": 0.1}}]
    assert len({of_tomorrow("corridor_dense", **change).digest for change in changes}) == 4


def test_a_section_that_came_later_survives_fields_of_its_own_to_come():
    class EarlierGround(BaseModel, frozen=True):
        slope: float = later(0.0, since="0.3")

    class EarlierScenario(Scenario):
        arena: LaterArena = LaterArena()
        ground: EarlierGround = later(EarlierGround(), since="0.3")

    document = {**load_scenario("corridor_dense").model_dump(), "ground": {"slope": 0.1}}
    earlier, now = (kind.model_validate(document) for kind in (EarlierScenario, LaterScenario))
    assert earlier.digest == now.digest
