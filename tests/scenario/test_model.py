"""Every field of a scenario: what it refuses, and in which words."""

from __future__ import annotations

import re
import warnings
from typing import get_origin

import pytest
from pydantic import BaseModel

from crowdbench.scenario import Scenario, ScenarioError, load_scenario

JARGON = re.compile(
    r"Input should|valid (tuple|integer|number|string|dictionary)|instance of|pattern|Keys should"
    r"|[Ff]ield required|validation error|errors\.pydantic",
)
WRONG = {
    "text": "many",
    "number as text": "3",
    "empty": "",
    "truth": True,
    "list": [1, "a", 3],
    "empty list": [],
    "one": [1],
    "nested": [[1, 2], [3, 4]],
    "section": {"a": 1},
    "null": None,
    "fraction": 0.123456,
    "negative": -1e9,
    "huge": 10**400,
    "huge float": 1e308,
    "tiny": 1e-320,
    "nan": float("nan"),
    "infinite": float("inf"),
    "object": object(),
    "bytes": b"x",
}


def leaves(model=Scenario, prefix=""):
    """Dotted names and fields of a model, sections included."""
    for name, field in model.model_fields.items():
        yield f"{prefix}{name}", field
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from leaves(field.annotation, f"{prefix}{name}.")


FIELDS = dict(leaves())
SCENARIO = load_scenario("multimodal_fast")
SAID = (
    "expected ",
    "unknown walking model",
    "unknown drive",
    "unknown region",
    "allowed: ",
    "unknown key",
    "exceeds",
    "is a value, not a section",
)


def refusal(field, value):
    """The message, or None where the value is taken."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            load_scenario(SCENARIO, **{field: value})
    except ScenarioError as error:
        return str(error)
    return None


@pytest.mark.parametrize("field", FIELDS)
def test_a_wrong_value_is_refused_in_words_that_name_the_field_and_what_it_takes(field):
    for value in WRONG.values():
        message = refusal(field, value)
        if message is None:
            continue
        assert not JARGON.search(message)
        assert "\n" not in message
        assert len(message) < 400
        assert field in message
        assert any(words in message for words in SAID)


@pytest.mark.parametrize("field", FIELDS)
def test_no_field_takes_a_value_of_another_kind(field):
    kind = FIELDS[field].annotation
    wrong = ["list", "nested", "object", "bytes"]
    if kind is not str:
        wrong += ["text", "number as text", "empty", "truth", "nan", "infinite", "huge"]
    if get_origin(kind) is not None or kind in (int, float):
        wrong += ["section"]
    for name in wrong:
        assert refusal(field, WRONG[name]) is not None, name


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("robots.speed", 1, "expected two numbers, lowest then highest, each >= -20 and <= 20"),
        ("robots.speed", [0, 1, 2], "expected two numbers, lowest then highest"),
        ("robots.speed", [0, "a"], "expected two numbers, lowest then highest"),
        (
            "robots.acceleration",
            "a",
            "two numbers, one for each number of an action, each >= 0.001",
        ),
        ("robots.acceleration", 3, ", or null (got 3)"),
        ("robots.count", "four", "expected a whole number >= 1 and <= 32 (got 'four')"),
        ("arena", "open", "arena: expected a section of `key: value` lines (got 'open')"),
        ("arena.kind", 3, "arena.kind: expected 'open', 'corridor' or 'map' (got 3)"),
        ("description", 3, "description: expected text (got 3)"),
        ("lidar.noise", True, "lidar.noise: expected a number >= 0 and <= 1 (got true)"),
    ],
)
def test_forms_are_named_in_words(field, value, told):
    assert told in refusal(field, value)


def test_acceleration_limits_are_no_range():
    scenario = load_scenario("multimodal_fast", robots={"acceleration": [2.0, 1.0]})
    assert scenario.robots.acceleration == (2.0, 1.0)


def test_whole_numbers_may_be_written_as_such_fractions():
    assert load_scenario("multimodal_fast", lidar={"beams": 90.0}).lidar.beams == 90


@pytest.mark.parametrize(
    ("period", "limit", "refused"),
    [(0.02, 2000, False), (0.019, 2000, True), (0.001, 100, False), (0.001, 101, True)],
)
def test_an_episode_has_at_most_100_000_steps(period, limit, refused):
    changes = {"control_period": period, "time_limit": limit}
    if not refused:
        assert load_scenario("multimodal_fast", **changes).max_steps <= 100_000
        return
    with pytest.raises(ScenarioError, match=r"control_period .* at most 100,000 steps; allowed"):
        load_scenario("multimodal_fast", **changes)


@pytest.mark.parametrize("value", [1e-6, 1e-320, 5e-324, 0.0])
def test_periods_and_sizes_too_small_to_compute_with_are_out_of_range(value):
    for field in ("control_period", "time_limit", "arena.length", "lidar.range", "robots.travel"):
        assert f"{field}: {value!r} is out of range; allowed: >= 0.001" in refusal(field, value)


def test_many_mistakes_are_counted_not_listed():
    changes = {f"wrong_{i}": i for i in range(1000)}
    with pytest.raises(ScenarioError) as caught:
        load_scenario("multimodal_fast", **changes)
    assert str(caught.value).endswith("; and 995 more")
    assert len(str(caught.value)) < 1500


OMNIDIRECTIONAL = {"robots.drive": "omnidirectional"}


@pytest.mark.parametrize(
    ("changes", "warned"),
    [
        ({}, False),
        ({"robots.speed": [0, 3.1]}, True),
        ({"robots.speed": [-3.1, 1]}, True),
        ({"control_period": 0.59}, False),
        ({"control_period": 0.61}, True),
        ({"robots.goal_tolerance": 0.09}, True),
        ({"robots.lateral_speed": [-3, 3]}, False),
        # 2.5 and 1.66 m/s make 3.001 m/s together, 0.6002 m in 0.2 s.
        (OMNIDIRECTIONAL | {"robots.speed": [0, 2.5], "robots.lateral_speed": [-1.66, 1]}, True),
        (OMNIDIRECTIONAL | {"robots.speed": [0, 2.5], "robots.lateral_speed": [-1.65, 1]}, False),
    ],
)
def test_a_goal_that_can_be_passed_between_two_steps_is_warned_of(changes, warned):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_scenario("multimodal_fast", **changes)
    assert bool(caught) is warned
    for warning in caught:
        assert "robots.goal_tolerance" in str(warning.message)
