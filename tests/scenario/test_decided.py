"""Fields that a recording decides: refused where they are set, left alone where inherited."""

import pytest
from crossings import walking

from crowdbench import ScenarioError, load_scenario

RECORDED = "pedestrians: {model: recorded, recording: walk.csv}\nrobots: {travel: 6}\n"
DECIDED = {
    "pedestrians.count": 12,
    "pedestrians.speed": [0.5, 1.5],
    "pedestrians.speed_mean": 0.5,
    "pedestrians.speed_deviation": 0.2,
    "pedestrians.goals": "multimodal",
    "pedestrians.switch_probability": 0.2,
    "pedestrians.leg": 5,
    "pedestrians.leg_from": "goal",
    "pedestrians.on_arrival": "stop",
    "pedestrians.acceleration": 2.0,
    "pedestrians.streams": [],
    "pedestrians.stops": {"share": 0.2},
    "pedestrians.standing": 0.0,
    "pedestrians.queues": [],
    "pedestrians.groups": {"share": 0.2},
    "arena.length": 20,
    "arena.width": 20,
}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "walk.csv").write_text(walking())
    (tmp_path / "crossing.yaml").write_text("extends: open\n" + RECORDED)
    return tmp_path


def load(folder, text, **changes):
    path = folder / "mine.yaml"
    path.write_text(text)
    return load_scenario(path, **changes)


@pytest.mark.parametrize("field", DECIDED)
def test_a_field_that_the_recording_decides_is_refused_where_it_is_set(folder, field):
    changes = {field: DECIDED[field]}
    told = f"{field}: .*; the recording decides it; allowed with pedestrians.model 'recorded': to l"
    with pytest.raises(ScenarioError, match=f"scenario '.*crossing.yaml': {told}"):
        load_scenario(folder / "crossing.yaml", **changes)
    with pytest.raises(ScenarioError, match=f"scenario 'crossing': {told}"):
        load_scenario(folder / "crossing.yaml").override(changes)
    section, _, name = field.partition(".")
    with pytest.raises(ScenarioError, match=f"scenario '.*mine.yaml': {told}"):
        load(folder, f"extends: crossing.yaml\n{section}: {{{name}: {DECIDED[field]}}}\n")


def test_it_is_refused_in_the_file_that_says_so_itself(folder):
    with pytest.raises(ScenarioError, match=r"mine.yaml': pedestrians.count: 12; the recording"):
        load(folder, RECORDED.replace("model", "count: 12, model"))


@pytest.mark.parametrize("scenario", ["open", "unimodal_slow", "hard_open_dense"])
def test_what_is_inherited_is_not_refused(folder, scenario):
    people = load(folder, f"extends: {scenario}\n{RECORDED}").pedestrians
    assert people.count == 6
    assert people.acceleration is None
    set_by_hand = {"model": "recorded", "recording": str(folder / "walk.csv")}
    assert load_scenario(scenario, pedestrians=set_by_hand).pedestrians.count == 6


def test_a_map_says_itself_how_large_it_is(folder):
    arena = {"kind": "map", "length": 30, "width": 20, "walls": [[-6, 5, 6, 5]]}
    assert load_scenario(folder / "crossing.yaml", arena=arena).arena.length == 30


def test_a_copy_of_all_fields_sets_none_in_particular(folder):
    scenario = load_scenario(folder / "crossing.yaml")
    copy = scenario.model_dump(mode="json")
    assert load_scenario("unimodal_slow", **copy) == scenario


@pytest.mark.parametrize("nothing", ["null", "{file: ''}"])
def test_who_walks_by_a_model_again_has_all_fields(folder, nothing):
    back = f"pedestrians: {{model: orca, count: 3, recording: {nothing}}}\n"
    assert load(folder, "extends: crossing.yaml\n" + back).pedestrians.count == 3


def test_people_are_simulated_again_by_changes_alone(folder):
    path = folder / "crossing.yaml"
    changes = {"pedestrians.model": "orca", "pedestrians.recording": None, "pedestrians.count": 3}
    assert (
        load_scenario(path, **changes).digest
        == load_scenario("open", **{"robots.travel": 6, "pedestrians.count": 3}).digest
    )
    again = load_scenario(path).override(changes).pedestrians
    assert (again.model, again.count, again.recording.file) == ("orca", 3, "")


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"recording": None}, "recording: missing; allowed: the path of a recording"),
        *(
            (
                {"recording": value},
                "recording: expected the path of a recording, a section that has it as `file`, or "
                f"null (got {value!r})",
            )
            for value in ("", 5, [])
        ),
    ],
    ids=str,
)
def test_what_is_no_recording_is_refused(folder, changes, told):
    with pytest.raises(ScenarioError) as refusal:
        load_scenario(folder / "crossing.yaml", pedestrians=changes)
    assert str(refusal.value).endswith(f"crossing.yaml': pedestrians.{told}")


def test_more_can_be_said_of_a_recording_that_is_a_path_alone(folder):
    changed = load_scenario(folder / "crossing.yaml", **{"pedestrians.recording.route": "along"})
    assert changed.pedestrians.recording.route == "along"
    extended = "extends: crossing.yaml\npedestrians: {recording: {route: along}}\n"
    assert load(folder, extended) == changed.model_copy(update={"name": "mine"})
