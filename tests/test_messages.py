"""Parts of messages: short, near, and in words."""

from __future__ import annotations

from typing import Annotated, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from crowdbench.messages import Form, allowed, brief, nearest, printable, setting, short


@given(
    st.recursive(
        st.none() | st.text() | st.integers() | st.floats() | st.binary(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    )
)
def test_a_value_is_shown_in_one_short_line(value):
    text = short(value)
    assert len(text) <= 100
    assert "\n" not in text


@pytest.mark.parametrize(
    "value",
    [10**100_000, "x" * 10**6, [[10**9000] * 1000] * 1000, {i: i for i in range(10**5)}],
    ids=["digits", "text", "nested", "section"],
)
def test_what_is_huge_is_shown_short_too(value):
    assert len(short(value)) <= 100


def test_a_value_that_contains_itself_is_shown():
    value: list[object] = []
    value.append(value)
    assert len(short(value)) <= 100


@pytest.mark.parametrize("value", [3, -0.25, "a", [1, 2], None, {"a": 1}, True])
def test_what_is_short_is_shown_as_python_writes_it(value):
    assert short(value) == repr(value)


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "null"), (True, "true"), ([None, {"a": False}], "[null, {'a': false}]"), ("a", "'a'")],
)
def test_a_setting_is_shown_as_its_file_has_it(value, text):
    assert setting(value) == text


def test_the_nearest_name_is_found_and_else_all_are_listed():
    assert nearest("colour", ["color", "sound"]) == "; did you mean 'color'?"
    assert nearest("zzz", ["color", "sound"]) == "; known: color, sound"
    assert nearest("c" * 5000, ["c" * 5000, "sound"]).startswith("; known: ")


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (int, "a whole number"),
        (bool, "true or false"),
        (Annotated[float, Field(gt=0, le=5)], "a number > 0 and <= 5"),
        (Annotated[int | None, Field(ge=1)], "a whole number >= 1, or null"),
        (Annotated[int, Field(ge=1)] | None, "a whole number >= 1, or null"),
        (Annotated[int, Field(ge=16, multiple_of=16)], "a whole number >= 16 and a multiple of 16"),
        (Literal["a", "b", "c"], "'a', 'b' or 'c'"),
        (tuple[float, float], "two numbers"),
        (Annotated[tuple[float, float], Form("low, then high")], "low, then high"),
        (Annotated[str, Form("a colour")], "a colour"),
    ],
)
def test_what_a_type_takes_is_said_in_words(kind, words):
    assert allowed(kind) == words


def test_a_name_is_shown_as_it_is_unless_a_terminal_could_not():
    assert printable("folder/päth.yaml") == "folder/päth.yaml"
    assert printable("a\nb\udcff") == "'a\\nb\\udcff'"


def test_what_a_library_says_is_one_line_of_at_most_200_characters():
    assert brief(ValueError("a\n\n  b")) == "a b"
    told = brief(ValueError("word " * 1000))
    assert len(told) == 200 and told.startswith("word word") and told.endswith("...")
