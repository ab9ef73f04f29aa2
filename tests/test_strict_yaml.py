"""YAML is read as plain data, and whatever is wrong is one short line with its place."""

from __future__ import annotations

import math

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench.strict_yaml import YamlError, dump_scalar, load_yaml, read_yaml


def refusal(text) -> str:
    with pytest.raises(YamlError) as caught:
        load_yaml(text)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 250
    return str(caught.value)


@pytest.mark.parametrize("text", ["1e-3", "-2E+4", "1.5e3", ".5e1", "-.5", "+7e0", "1.e2"])
def test_numbers_of_yaml_1_2_are_numbers(text):
    assert load_yaml(text) == float(text)
    assert load_yaml(f"{{a: [{text}]}}") == {"a": [float(text)]}


@pytest.mark.parametrize("text", ["e3", "1e", "1e-3x", "0x1e", "12e4e5", "2031-02-03", "=", "<<"])
def test_text_stays_text(text):
    assert load_yaml(text) in (text, 0x1E)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a: 1\nb: 2\na: 3", "line 3: the key 'a' stands twice, first in line 1"),
        ("s:\n  x: 1\n  y: {z: 1, z: 2}", "line 3: the key 'z' stands twice"),
        ("a: 1\n1.0: 2\n1: 3", "line 3: the key 1 stands twice"),
        ("a: &x [1]\nb: *x", "line 2: an alias (*) is not allowed"),
        ("a: &x [*x]", "line 1: an alias"),
        ("a: !!python/name:os.system x", "line 1: the tag"),
        ("\na: !!set {x}", "line 2: the tag"),
        ("a: !!float ''", "line 1"),
        ("a: !!bool maybe", "line 1"),
        ('b: 1\na: "\\UFFFFFFFF"', "line 2"),
        ("a: 0b_", "line 1"),
        ('b: 1\na: "\\ud83d"', "line 2"),
        ("[x]: 1", "line 1"),
        ("a: 1\nb: \0", "line 2: character 0x0 is not allowed"),
        ("a: \udc80", "character 0xdc80 is not allowed"),
        ("a: [", "line 1"),
        ("--- 1\n--- 2", "line 2"),
        ("%YAML 9.9\n--- 1", "line 1"),
        ("a: " + "9" * 5000, "line 1: a number of more than 4300 digits"),
        ("a: 0x" + "f" * 4200, "line 1"),
        ("a: 1" + ":1" * 100_000, "line 1: a number of more than 4300 digits"),
        ("[" * 100_000, "line 1: nested more than 32 deep"),
        ("{a: " * 5000, "line 1: nested more than 32 deep"),
        ("- " * 2000, "line 1: nested more than 32 deep"),
        ("a: !" + "x" * 10_000 + " 1", "line 1"),
    ],
)
def test_what_is_refused_is_named_with_its_line(text, told):
    assert told in refusal(text)


def test_files_are_named(tmp_path):
    path = tmp_path / "some.yaml"
    path.write_text("a: 1\na: 2")
    for spoil in (None, b"\xff\xfe\xfa", b"#" * 1_000_001):
        if spoil is not None:
            path.write_bytes(spoil)
        with pytest.raises(YamlError, match=r"some\.yaml"):
            read_yaml(path)
    with pytest.raises(YamlError, match=r"some.yaml/x: cannot be read"):
        read_yaml(path / "x")


SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False)
    | st.text(st.characters(codec="ascii", exclude_categories=["Cc"]), max_size=30)
    | st.from_regex(r"[-+]?[0-9.]{1,3}[eE:_x][-+0-9]{1,3}", fullmatch=True)
)


@given(SCALARS)
def test_the_text_of_a_scalar_gives_it_back(value):
    again = load_yaml(dump_scalar(value))
    assert again == value
    assert type(again) is type(value)


@given(SCALARS)
def test_text_is_also_what_other_parsers_of_yaml_read(value):
    assert yaml.safe_load(dump_scalar(value)) == value


def test_infinity_has_a_text_and_an_object_has_none():
    assert load_yaml(dump_scalar(math.inf)) == math.inf
    with pytest.raises(YamlError, match="has no text"):
        dump_scalar(object())


FRAGMENTS = (
    "2001-99-99", "9" * 5000, "[" * 300, "&a [*a]", "!!float ''", "!!binary x", '"\\ud800"',
    '"\\U99999999"', "0x_", "\0", "\udc80", "- ", "? ", ": ", "{", "}", "%YAML 9\n---\n", "\n", "'",
    "|\n", "<<: {a: 1}", "1e-320", "a: 1\n", "1: 2\n", "\ufeff", "\t", "# ", "*",
)  # fmt: skip


@settings(max_examples=300, deadline=None)
@given(st.lists(st.sampled_from(FRAGMENTS) | st.text(max_size=4), max_size=6).map("".join))
def test_any_text_is_plain_data_or_one_line(text):
    try:
        value = load_yaml(text)
    except YamlError as error:
        assert "\n" not in str(error)
        assert len(str(error)) < 250
    else:
        assert isinstance(value, None.__class__ | bool | int | float | str | list | dict)
