"""Room for frames changes nothing about a function."""

import inspect
import sys

import pytest

from crowdbench.call_stack import with_room


def _deep(levels: int) -> int:
    return 1 + _deep(levels - 1) if levels else 0


def test_a_function_with_room_is_the_same_function():
    def sum_of(a, b=2, *, c=3):
        """Three numbers."""
        return a + b + c

    roomy = with_room(sum_of)
    assert roomy is sum_of
    assert roomy(1, c=10) == 13
    assert str(inspect.signature(roomy)) == "(a, b=2, *, c=3)"
    assert roomy.__doc__ == "Three numbers."


def test_calls_below_it_go_as_deep_as_ever_and_no_deeper():
    deepest = sys.getrecursionlimit()
    assert with_room(_deep)(deepest // 2) == deepest // 2
    with pytest.raises(RecursionError):
        _deep(deepest + 1)


@pytest.mark.skipif(sys.version_info < (3, 11), reason="frames lie in chunks from Python 3.11 on")
def test_its_frame_asks_for_a_chunk_that_many_frames_fit_in():
    def roomy():
        return None

    ordinary = roomy.__code__.co_stacksize
    assert with_room(roomy).__code__.co_stacksize > 1000 * ordinary
