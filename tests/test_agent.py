from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench import RobotSpec, load_scenario
from crowdbench.agent import AgentError, AgentSpec, agent_names, agent_options

PLANNER = """
from __future__ import annotations
from dataclasses import dataclass
import crowdbench

@dataclass
class Memory:
    steps: int = 0

class Planner(crowdbench.Agent):
    def __init__(self, gain=1.0, mode="calm"):
        self.gain = gain
    def reset(self, robot, seed):
        self.memory = Memory()
    def act(self, observation):
        return 0.0, 0.0
"""


@pytest.fixture
def written(tmp_path):
    """Writes an agent file and returns its path."""

    def write(text, name="planner.py"):
        path = tmp_path / name
        path.write_text(text)
        return str(path)

    return write


def refusal(text) -> str:
    with pytest.raises(AgentError) as caught:
        AgentSpec.parse(text).make()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_name_and_its_options():
    spec = AgentSpec.parse("orca:horizon=2.5,mode=fast, seen=true")
    assert spec.name == "orca"
    assert spec.options == {"horizon": 2.5, "mode": "fast", "seen": True}
    assert str(spec) == "orca:horizon=2.5,mode=fast,seen=true"


def test_the_order_of_options_does_not_matter():
    assert str(AgentSpec.parse("a:x=1,b=2")) == str(AgentSpec.parse("a:b=2,x=1"))


@given(
    st.dictionaries(
        st.from_regex(r"[a-z_]{1,8}", fullmatch=True),
        st.none()
        | st.booleans()
        | st.integers()
        | st.floats(allow_nan=False)
        | st.text(max_size=40),
        max_size=4,
    )
)
def test_the_text_of_a_spec_gives_the_spec_back_or_is_refused(options):
    try:
        spec = AgentSpec("planner", options)
    except AgentError:
        text = [value for value in options.values() if isinstance(value, str)]
        assert any("," in value or not value.isprintable() or not value.isascii() for value in text)
        return
    assert AgentSpec.parse(str(spec)) == spec
    assert str(spec).isprintable()


@pytest.mark.parametrize("value", [[1, 2], {"a": 1}, float("nan"), "a,b"])
def test_an_option_that_text_cannot_say_is_refused(value):
    with pytest.raises(AgentError, match="option 'x': expected a number"):
        AgentSpec("planner", {"x": value})


@pytest.mark.parametrize("text", ["orca:horizon", "orca:=3", "orca:x=[1", "new\nline", "nul\0"])
def test_text_that_names_no_agent_is_refused(text):
    with pytest.raises(AgentError):
        AgentSpec.parse(text)


def test_the_option_file_may_come_first_without_its_name():
    spec = AgentSpec.parse("planner:folder/2.weights,gain=2")
    assert spec == AgentSpec("planner", {"file": "folder/2.weights", "gain": 2})
    assert str(spec) == "planner:file=folder/2.weights,gain=2"
    assert AgentSpec.parse("mine.py:Mine:a.bin") == AgentSpec("mine.py:Mine", {"file": "a.bin"})
    assert (
        refusal("orca:a.bin") == "agent 'orca' has no option 'file'; known: responsibility, margin"
    )


def test_an_option_without_a_default_is_needed(written):
    path = written(PLANNER.replace("gain=1.0", "gain"))
    assert refusal(path) == f"agent {path!r} needs the option 'gain'"
    assert AgentSpec.parse(f"{path}:gain=2").make().gain == 2


def test_unknown_agent_names_the_nearest():
    assert refusal("orcaa") == "unknown agent 'orcaa'; did you mean 'orca'?"
    assert "straight_line" in refusal("qqqqqq")


def test_unknown_option_names_the_nearest(written):
    path = written(PLANNER)
    assert "has no option 'gian'; did you mean 'gain'?" in refusal(f"{path}:Planner:gian=2")
    assert "it takes no options" in refusal("straight_line:speed=2")


@pytest.mark.parametrize("suffix", ["", ":Planner", ":gain=3", ":Planner:gain=3"])
def test_one_file_is_an_agent(written, suffix):
    agent = AgentSpec.parse(written(PLANNER) + suffix).make()
    assert agent.gain == (3 if "gain" in suffix else 1.0)
    agent.reset(RobotSpec.from_scenario(load_scenario("multimodal_fast")), seed=0)
    assert agent_options(type(agent)) == {"gain": 1.0, "mode": "calm"}


def test_two_files_of_one_name_do_not_mix(written, tmp_path):
    (tmp_path / "other").mkdir()
    first = AgentSpec.parse(written(PLANNER)).make()
    second = AgentSpec.parse(written(PLANNER.replace("1.0", "2.0"), "other/planner.py")).make()
    assert (first.gain, second.gain) == (1.0, 2.0)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("def planner(:", "SyntaxError"),
        ("1 / 0", "ZeroDivisionError: division by zero ("),
        ("raise SystemExit(3)", "SystemExit: 3"),
        ("x = 1", "expected file.py:Class; agent classes found: none"),
        (PLANNER + "class Other(Planner): pass", "agent classes found: Planner, Other"),
        (PLANNER.replace("self.gain = gain", "raise ValueError('no')"), "ValueError: no ("),
        (PLANNER.replace("self.gain = gain", "open('/no/weights')"), "FileNotFoundError"),
    ],
)
def test_a_broken_file_is_refused_with_the_reason_and_the_place(written, text, told):
    path = written(text)
    message = refusal(path)
    assert told in message
    assert path in message


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (PLANNER.replace("def act", "def atc"), "class 'Planner' has no method act;"),
        (
            "import crowdbench\nclass Planner(crowdbench.Agent): pass",
            "class 'Planner' has no method act and no method reset;",
        ),
        (
            PLANNER.replace("(crowdbench.Agent)", ""),
            "class 'Planner' is not a subclass of crowdbench.Agent",
        ),
    ],
)
def test_a_class_that_is_no_agent_is_told_what_it_lacks(written, text, told):
    message = refusal(f"{written(text)}:Planner")
    assert told in message
    assert "agent.py:" not in message


def test_what_installed_agents_say_of_their_options_is_told_as_they_say_it():
    assert refusal("informed:futures=3") == (
        "agent 'informed:futures=3': option 'futures' goes with intent=sampled, not with "
        "intent=known"
    )


def test_a_missing_file_and_a_missing_class_are_named(written):
    assert refusal("no_such.py:Planner") == "agent file 'no_such.py' does not exist"
    message = refusal(written(PLANNER) + ":Planer")
    assert "no agent class 'Planer'; agent classes found: Planner" in message


def test_built_in_agents_are_listed():
    assert {"straight_line", "orca", "latent_planner"} <= set(agent_names())


@pytest.mark.parametrize(
    ("text", "options", "again"),
    [
        ("a:x=1e-3", {"x": 0.001}, "a:x=0.001"),
        ("a:x='1e-3'", {"x": "1e-3"}, "a:x='1e-3'"),
        ("a:x=2020-01-01", {"x": "2020-01-01"}, "a:x='2020-01-01'"),
    ],
)
def test_numbers_are_those_of_yaml_1_2_and_dates_are_text(text, options, again):
    spec = AgentSpec.parse(text)
    assert spec.options == options
    assert str(spec) == again
    assert AgentSpec.parse(again) == spec


@pytest.mark.parametrize(
    "text",
    [
        "a:execute=10,horizon=10", "a:execute=6,weights=no_social", "a:policy_prior=false",
        "a:smoothness_weight=0", "a:x=0.25", "a:x='yes'", "a:x=null", "a:x=1.0e-05", "a:x='='",
        "folder/mine.py:Mine:gain=2.5", "a:x='12'", "a:x=-3", "a:x=.inf",
    ],
)  # fmt: skip
def test_texts_of_stored_agents_stay_as_they_are(text):
    assert str(AgentSpec.parse(text)) == text


@pytest.mark.parametrize(
    "text",
    [
        "a:x=" + "9" * 5000, "a:x=0x" + "f" * 4000, "a:x=" + "[" * 5000, "a:x=&b [*b]", "a:x=\0",
        "a:x=\udc80", "a:x=!!float ''", 'a:x="\\UFFFFFFFF"', "x" * 5000, "x" * 5000 + ".py",
        "a/" * 4000 + "b.py", "orca:" + "x" * 5000 + "=1", "a:x=" + "{b: " * 900,
        "orca:margin=1e999", "a:" + "y" * 9000,
    ],
    ids=range(15),
)  # fmt: skip
def test_whatever_text_is_given_the_answer_is_a_short_line(text):
    assert len(refusal(text)) < 400


@settings(max_examples=150, deadline=None)
@given(
    st.sampled_from(["orca", "dynamic_window", "straight_line", "x.py:X"]),
    st.lists(
        st.sampled_from([":", ",", "=", "margin", "speed", "1e-3", "&a", "*a", "!!int", "\0", "'"])
        | st.text(max_size=3),
        max_size=8,
    ).map("".join),
)
def test_mutated_texts_make_an_agent_or_a_line(name, rest):
    try:
        AgentSpec.parse(name + rest).make()
    except AgentError as error:
        assert "\n" not in str(error)
        assert len(str(error)) < 400
