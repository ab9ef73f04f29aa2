from __future__ import annotations

import warnings

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from crowdbench.scenario import Scenario, ScenarioError, load_scenario, parse_overrides
from crowdbench.scenario import scenario_names as names

SCENARIO = load_scenario("multimodal_fast")


@pytest.fixture
def written(tmp_path):
    """Writes a scenario file and returns its path."""

    def write(text, name="mine.yaml"):
        path = tmp_path / name
        path.write_text(text)
        return str(path)

    return write


def refusal(name, /, **changes) -> str:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(name, **changes)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_tables_scenarios_are_there_in_their_order():
    motions = ["unimodal_slow", "unimodal_fast", "multimodal_slow", "multimodal_fast"]
    corridors = [f"corridor_{how}" for how in ("sparse", "moderate", "dense", "very_dense")]
    assert names("paper") == [*motions, *(f"{name}_nonreactive" for name in motions), *corridors]


@pytest.mark.parametrize("name", names("paper"))
def test_a_nonreactive_twin_differs_in_nothing_but_who_sees_the_robot(name):
    scenario = load_scenario(name)
    if name.endswith("_nonreactive"):
        twin = load_scenario(name.removesuffix("_nonreactive"))
        assert scenario.pedestrians.reactive == 0
        assert twin.override({"pedestrians.reactive": 0}).digest == scenario.digest
    else:
        assert scenario.pedestrians.reactive == 1


def test_corridors_have_the_papers_densities():
    counts = [
        (scenario.obstacles.count, scenario.pedestrians.count)
        for scenario in (load_scenario(name) for name in names() if name.startswith("corridor"))
    ]
    assert counts == [(2, 0), (3, 2), (3, 4), (4, 6)]


def test_unknown_scenario_names_the_nearest():
    assert "did you mean 'multimodal_fast'?" in refusal("multimodal_fst")


@pytest.mark.parametrize("name", ["", "/tmp", "../open", "x" * 5000, "nul\0"])
def test_whatever_is_no_scenario_is_unknown(name):
    assert "unknown scenario" in refusal(name)


@pytest.mark.parametrize("name", ["hard", "situation"])
def test_what_a_tier_extends_is_said_to_be_no_scenario(name):
    message = refusal(name)
    assert message.startswith(f"scenario {name!r}: robots.start: null; allowed on a map")
    assert message.endswith(
        f"; {name!r} alone is no scenario but what those of tier {name!r} extend; crowdbench "
        "scenarios lists them"
    )
    assert "pedestrians.cout" in refusal(name, **{"pedestrians.cout": 3})
    assert "tier" not in refusal("open", **{"pedestrians.cout": 3}), "others are scenarios too"


def test_a_tier_is_said_to_be_no_scenario():
    assert refusal("paper") == (
        "'paper' is a tier, not a scenario; allowed: those that crowdbench scenarios lists in it"
    )


@pytest.mark.parametrize(
    ("key", "kind", "whole"),
    [
        ("pedestrians.streams.0.share", "list", "pedestrians.streams=[...], the whole list"),
        ("pedestrians.count.least", "value", "pedestrians.count=..."),
        ("time_limit.a.b", "value", "time_limit=..."),
    ],
)
def test_a_key_that_leads_into_a_value_says_how_that_is_set(key, kind, whole):
    name = whole.partition("=")[0].split(".")[-1]
    told = f"{key}: {name!r} is a {kind}, not a section; allowed: {whole}"
    assert refusal("situation_doorway", **{"time_limit": 40, key: 1}) == told


def test_a_missing_file_is_named():
    assert refusal("no/such.yaml") == "scenario file 'no/such.yaml' does not exist"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("pedestrians: {cout: 3}", "unknown key 'pedestrians.cout'; did you mean 'count'?"),
        (
            "pedestrians: {route: along}",
            "unknown key 'pedestrians.route'; did you mean 'pedestrians.recording.route'?",
        ),
        (
            "robots: {radius: 0.2}",
            "'robots.radius'; did you mean 'obstacles.radius' or 'pedestrians.radius'?",
        ),
        ("count: 3", "'count'; did you mean 'robots.count' or 'obstacles.count' or 'pedest"),
        ("pedestrians: {radius: null}", "each >= 0.001 and <= 2 (got null)"),
        ("lidar: null", "lidar: expected a section of `key: value` lines (got null)"),
        ("lidar: {noise: true}", "lidar.noise: expected a number >= 0 and <= 1 (got true)"),
        ("arena: {walls: [null]}", "wall 1 is null; allowed: four numbers"),
        ("pedestrian: {count: 3}", "unknown key 'pedestrian'; did you mean 'pedestrians'?"),
        ("pedestrians: {1: 3}", "pedestrians: the key 1 is not a name"),
        ("1: 3", "the key 1 is not a name"),
        ("- a", "expected 'key: value' lines, got list"),
        ("a: [", "not a YAML file"),
        (
            "extends: open\nlidar: {beams: 9}\nlidar: {noise: 0}",
            "line 3: the key 'lidar' stands twice",
        ),
        ("lidar:\n  beams: 9\n  noise: 0\n  beams: 9", "line 4: the key 'beams' stands twice"),
        ("extends: open\narena: &a {length: *a}", "line 2: an alias"),
        ("time_limit: 2031-02-30", "time_limit: expected a number >= 0.001 and <= 3600"),
        ("lidar: {beams: " + "8" * 5000 + "}", "line 1: a number of more than 4300 digits"),
        ("lidar: {noise: " + "8" * 4000 + "}", "lidar.noise: expected a number >= 0 and <= 1"),
        ("arena: " + "[" * 4000, "nested more than 32 deep"),
        ('description: "\\ud800"', "is no value of its type"),
        ("extends: " + "a/" * 3000 + "b", "unknown scenario 'a/a/"),
        ("extends: " + "a/" * 3000 + "b.yaml", "scenario file '"),
        ("name: !!python/object/apply:os.getcwd []", "not a YAML file"),
        ("extends: 3", "extends: expected the name of a scenario, got 3"),
        ("extends: opn_x", "unknown scenario 'opn_x'"),
        ("pedestrians: 7", "pedestrians: expected a section of `key: value` lines"),
        ("pedestrians: {model: 7}", "pedestrians.model: expected text (got 7)"),
        ("pedestrians: {model: orcas}", "unknown walking model 'orcas'; did you mean 'orca'?"),
        (
            "pedestrians: {model: walk}",
            "model 'walk'; known: orca, recorded, social_force, ",
        ),
        ("robots: {drive: hover}", "robots.drive: unknown drive 'hover'; known: differential, "),
    ],
)
def test_a_file_that_is_wrong_is_refused_with_the_reason(written, text, told):
    path = written(text)
    message = refusal(path)
    assert told in message
    assert path in message or "extends" in text
    assert len(message) < 800


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("pedestrians.count", 1000, "pedestrians.count: 1000 is out of range; allowed: >= 0"),
        ("pedestrians.count", 1000, "<= 500"),
        ("lidar.beams", 0, "lidar.beams: 0 is out of range; allowed: >= 1 and <= 4096"),
        ("pedestrians.speed", [-1, 1], "pedestrians.speed: -1 is out of range; allowed: >= 0"),
        (
            "robots.acceleration",
            [1, 0],
            "robots.acceleration: 0 is out of range; allowed: >= 0.001",
        ),
        ("pedestrians.speed", [2, 1], "pedestrians.speed: the lower bound 2.0 exceeds the upper"),
        (
            "arena.length",
            float("nan"),
            "arena.length: expected a number >= 0.001 and <= 200 (got nan)",
        ),
        ("reward.arrival", float("inf"), "reward.arrival: expected a number"),
        ("pedestrians.count", 2.5, "pedestrians.count: expected a whole number >= 0 and <= 500"),
        ("name", "a/b", "name: expected 1 to 100 letters, digits and _.- (got 'a/b')"),
        ("arena.length.x", 1, "arena.length.x: 'length' is a value, not a section"),
    ],
)
def test_a_value_out_of_range_is_named_with_its_field_and_range(field, value, told):
    assert told in refusal("multimodal_fast", **{field: value})


def test_a_file_extends_another_and_merges_section_by_section(written):
    written("extends: multimodal_fast\npedestrians: {count: 3}", "base.yaml")
    scenario = load_scenario(written("extends: base.yaml\npedestrians: {radius: 0.3}"))
    assert scenario.name == "mine"
    assert (scenario.pedestrians.count, scenario.pedestrians.radius) == (3, 0.3)
    assert scenario.pedestrians.goals == "multimodal"


def test_a_description_is_of_its_own_file_alone(written):
    assert load_scenario(written("extends: multimodal_fast\n", "mine.yaml")).description == ""
    told = load_scenario(written("extends: mine.yaml\ndescription: A hall\n", "hall.yaml"))
    assert told.description == "A hall"
    assert load_scenario("multimodal_fast", pedestrians={"count": 3}).description


@pytest.mark.parametrize("base", ["mine.yaml", "./mine.yaml", "sub/../mine.yaml"])
def test_a_file_that_extends_itself_is_refused(written, tmp_path, base):
    (tmp_path / "sub").mkdir()
    assert "extends itself" in refusal(written(f"extends: {base}"))


def test_overrides_from_a_command_line_are_yaml_values():
    changes = parse_overrides(["pedestrians.count=12", "pedestrians.speed=[0.2, 0.4]", "name=mine"])
    scenario = load_scenario("multimodal_fast", **changes)
    assert (scenario.pedestrians.count, scenario.pedestrians.speed) == (12, (0.2, 0.4))
    assert scenario.name == "mine"


def test_numbers_with_exponents_are_numbers_everywhere(written):
    path = written("extends: open\nlidar: {noise: 1e-3}\ntime_limit: 3e1")
    scenario = load_scenario(path, **parse_overrides(["robots.travel=5e0", "lidar.beams=9e1"]))
    assert (scenario.lidar.noise, scenario.time_limit) == (0.001, 30)
    assert (scenario.robots.travel, scenario.lidar.beams) == (5, 90)


@pytest.mark.parametrize("item", ["pedestrians.count", "=3", "a=[", "a={b: 1, b: 2}", "a=*b"])
def test_an_override_that_is_none_is_refused(item):
    with pytest.raises(ScenarioError, match="--set"):
        parse_overrides([item])


def test_nested_dotted_and_later_overrides_are_the_same_and_keep_the_rest():
    nested = load_scenario("multimodal_fast", pedestrians={"count": 12})
    assert nested == load_scenario("multimodal_fast", **{"pedestrians.count": 12})
    assert nested == load_scenario("multimodal_fast").override({"pedestrians": {"count": 12}})
    assert nested.pedestrians.goals == "multimodal"


@given(
    field=st.sampled_from(
        ["control_period", "arena.width", "robots.travel", "lidar.range", "pedestrians.leg"]
    ),
    factor=st.floats(0.5, 0.99),
)
def test_the_digest_changes_with_the_world_and_only_with_it(field, factor):
    scenario = load_scenario("multimodal_fast")
    section, _, name = field.rpartition(".")
    value = getattr(getattr(scenario, section) if section else scenario, name)
    assert scenario.override({field: value * factor}).digest != scenario.digest
    named = scenario.override({"name": "other", "description": "", "reward.social": 0})
    assert named.digest == scenario.digest


def test_a_scenario_survives_its_own_serialisation():
    scenario = load_scenario("corridor_dense")
    assert Scenario.model_validate_json(scenario.model_dump_json()) == scenario


WORLD = """\
extends: corridor_dense
name: mine
time_limit: 30.5
arena: {length: 15, width: 3}
robots:
  speed: [-0.3, 1.2]
  acceleration: [0.8, 1.6]
  travel: 11
lidar: {noise: 1e-3}  # m
"""
PIECES = (
    "2031-02-30", "9" * 5000, "[" * 200, "{a: " * 50, "&a [*a]", "!!float ''", "!!timestamp x",
    '"\\ud800"', '"\\UFFFFFFFF"', "0x_", "1e999", "1e-320", ".nan", "\0", "\ud800", "- ", "? ",
    ": ", "%YAML 9.9\n---\n", "<<: {a: 1}\n", "1: 2\n", "[1]: 2\n", "arena: {}\n", "'", "|\n", "\t",
    "extends: [x]\n", "x" * 5000, "\ufeff", "null", "[[1, 2], 3]", "\u2028", "extends: mine.yaml\n",
)  # fmt: skip
MUTATIONS = st.lists(
    st.tuples(
        st.integers(0, len(WORLD)), st.integers(0, 8), st.sampled_from(PIECES) | st.text(max_size=2)
    ),
    min_size=1,
    max_size=3,
)


def mutated(text, mutations):
    for start, length, piece in mutations:
        text = text[:start] + piece + text[start + length :]
    return text


def assert_loads_or_is_refused_in_a_short_line(load):
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            load()
    except ScenarioError as error:
        assert "\n" not in str(error)
        assert len(str(error)) < 1000


@settings(
    max_examples=250, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(MUTATIONS)
def test_any_file_is_a_scenario_or_a_line(tmp_path, mutations):
    path = tmp_path / "mine.yaml"
    path.write_bytes(mutated(WORLD, mutations).encode("utf-8", "surrogatepass"))
    assert_loads_or_is_refused_in_a_short_line(lambda: load_scenario(path))


@settings(max_examples=200, deadline=None)
@given(
    st.sampled_from(
        ["lidar.noise=1e-3", "robots.speed=[0, 1]", "arena={length: 9}", "name=x", "lidar=3"]
    ),
    MUTATIONS,
)
def test_any_override_is_taken_or_is_a_line(item, mutations):
    item = mutated(item, mutations)
    assert_loads_or_is_refused_in_a_short_line(
        lambda: load_scenario(SCENARIO, **parse_overrides([item]))
    )


def test_a_file_with_a_name_that_cannot_be_printed_is_named_all_the_same(written):
    message = refusal(written("a: [", "odd\n\udcff.yaml"))
    assert "odd\\n\\udcff.yaml" in message
    assert message.isprintable()
