"""An entry: what it refuses, what it measures, how its numbers are printed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from crowdbench.evaluation.metric import Metric, MetricError
from crowdbench.evaluation.metrics import METRICS, metrics


def metric(value=0.5, kind="mean", **fields):
    return Metric(lambda episode: value, "m", "higher", "some length", kind, **fields)


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"kind": "share"}, "kind: expected proportion or mean or count, got 'share'"),
        ({"kind": "mean", "scale": 0}, "scale: expected a number > 0, got 0"),
        ({"kind": "mean", "scale": math.nan}, "scale: expected a number > 0, got nan"),
        ({"kind": "count", "weight": "steps"}, "weight: expected none for a count, got 'steps'"),
    ],
)
def test_an_entry_that_says_nothing_allowed_is_refused(fields, told):
    with pytest.raises(MetricError) as caught:
        metric(**fields)
    assert str(caught.value) == told


def test_a_direction_is_higher_or_lower():
    with pytest.raises(MetricError, match="better: expected higher or lower, got 'more'"):
        Metric(math.cos, "", "more", "", "mean")


@pytest.mark.parametrize(
    ("value", "kind", "expected"),
    [
        (np.float32(0.5), "mean", 0.5),
        (True, "proportion", 1.0),
        (np.array(3), "count", 3.0),
        (math.nan, "proportion", math.nan),
    ],
)
def test_a_value_is_a_plain_number(make_episode, value, kind, expected):
    measured = metric(value, kind).measure("mine", make_episode([[0, 0, 0]]))
    assert type(measured) is float
    assert measured == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize(
    ("value", "kind", "told"),
    [
        (0.5, "proportion", "a proportion is 0 or 1 for each episode, not 0.5"),
        (None, "mean", "TypeError: float() argument must be"),
        (np.zeros(2), "mean", "TypeError: only"),
    ],
)
def test_what_cannot_be_measured_is_said_with_the_episode(make_episode, value, kind, told):
    episode = make_episode([[0, 0, 0]])
    with pytest.raises(MetricError) as caught:
        metric(value, kind).measure("mine", episode)
    where = f"metric 'mine', {episode.scenario}, seed {episode.seed}, {episode.robot}: "
    assert str(caught.value).startswith(where + told)


def test_a_function_that_fails_is_named(make_episode):
    broken = Metric(lambda episode: 1 / 0, "", "lower", "", "mean")
    with pytest.raises(MetricError, match=r"metric 'mine', .*: ZeroDivisionError: division"):
        broken.measure("mine", make_episode([[0, 0, 0]]))


def test_what_an_entry_leaves_out_follows_from_the_rest():
    assert metric().title("my_length") == "my length"
    assert metric(label="Length").title("my_length") == "Length"
    assert metric().printed_unit == "m"
    assert metric(printed_unit="cm", scale=100).printed_unit == "cm"


@pytest.mark.parametrize(
    ("fields", "value", "beside", "printed"),
    [
        ({"digits": 2}, 0.1249, None, "0.12"),
        ({"digits": 2}, -0.0001, None, "0.00"),
        ({"digits": 0}, 12.7, None, "13"),
        ({"digits": 1, "scale": 100, "printed_unit": "cm"}, 0.0514, None, "5.1"),
        ({}, 0.00514, None, "0.0051"),
        ({}, 123.4, None, "123"),
        ({"scale": 1000}, 0.00514, None, "5.1"),
        ({}, 0.12345, 0.00514, "0.1235"),
        ({}, 0.0, None, "0"),
        ({}, 1e-17, None, "0"),
    ],
)
def test_numbers_have_the_decimals_of_the_entry_or_two_significant_digits(
    fields, value, beside, printed
):
    assert metric(**fields).number(value, beside) == printed


@pytest.mark.parametrize("name", ["seed", "world", "Steps", "source", "EPISODE", "SPL", "torch"])
def test_a_name_of_another_column_is_refused(name):
    with pytest.raises(ValueError, match=f"metric {name!r}: the results have a column "):
        METRICS.register(name, metric())
    assert name not in METRICS


def test_a_weight_that_nothing_measures_is_said_by_name(make_episode, monkeypatch):
    monkeypatch.setitem(METRICS._known, "mine", metric(weight="path_lenght"))
    with pytest.raises(MetricError, match="metric 'mine': weight: unknown metric 'path_lenght'"):
        metrics(make_episode([[0, 0, 0]]))
