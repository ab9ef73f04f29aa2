"""What arrives from a worker is read as far as it is there, and is made of what answers are."""

import os
import pickle
from multiprocessing import Pipe

import numpy as np
import pytest

from crowdbench import NoRoomError
from crowdbench.agent import AgentError
from crowdbench.evaluation.answers import AnswerReader, UnreadableAnswerError
from crowdbench.evaluation.driven import Driven
from crowdbench.evaluation.protocol import Broken, Described, Done, Refused


@pytest.fixture
def pipe():
    """A reader and the other end."""
    ours, theirs = Pipe()
    reader = AnswerReader(ours)
    yield reader, theirs
    reader.close()
    ours.close()
    theirs.close()


@pytest.mark.parametrize(
    "answer",
    [
        Described("00ff", "a file", None),
        Done([Driven("robot_0", np.ones((3, 2)), np.zeros(3), "timeout", None, {"plans": 3.0})]),
        Refused(AgentError("no weights")),
        Refused(NoRoomError("too many people", 3)),
        Broken("Traceback ..."),
    ],
)
def test_every_answer_comes_through(pipe, answer):
    reader, theirs = pipe
    theirs.send((1, answer))
    ((number, found),) = reader.read()
    assert number == 1
    assert repr(found) == repr(answer)


def test_messages_are_read_one_by_one_however_they_arrive(pipe):
    reader, theirs = pipe
    text = pickle.dumps((2, "x" * 100))
    content = len(text).to_bytes(4, "big") + text
    theirs.send((1, "first"))
    os.write(theirs.fileno(), content[:3])
    assert list(reader.read()) == [(1, "first")]
    os.write(theirs.fileno(), content[3:50])
    assert list(reader.read()) == []
    os.write(theirs.fileno(), content[50:])
    assert list(reader.read()) == [(2, "x" * 100)]
    assert not reader.ended
    theirs.close()
    assert list(reader.read()) == []
    assert reader.ended


@pytest.mark.parametrize(
    "content",
    [
        b"\x7f\xff\xff\xff",  # 2 GB
        b"\xff\xff\xff\xff" + (1 << 40).to_bytes(8, "big"),  # the long form, 1 TB
        b"\xff\xff\xff\xfe",  # less than nothing
        b"\x00\x00\x00\x05hello",
        b"\x00\x00\x00\x00",
    ],
)
def test_what_is_no_message_is_refused(pipe, content):
    reader, theirs = pipe
    os.write(theirs.fileno(), content)
    with pytest.raises(UnreadableAnswerError):
        list(reader.read())


@pytest.mark.parametrize("thing", [os.getcwd, pickle.loads, np.frombuffer, Pipe])
def test_nothing_but_parts_of_an_answer_is_made(pipe, thing):
    reader, theirs = pipe
    theirs.send((1, thing))
    with pytest.raises(UnreadableAnswerError):
        list(reader.read())
