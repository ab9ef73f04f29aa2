"""Functions of arrays against the standard library."""

import math

import numpy as np

from crowdbench.libm import atan2, exp


def test_functions_of_arrays_are_those_of_the_standard_library_place_by_place():
    y, x = np.random.default_rng(0).uniform(-9, 9, (2, 100, 1)), np.linspace(-3, 3, 20)
    assert atan2(y[0], x).tolist() == [[math.atan2(b, a) for a in x.tolist()] for (b,) in y[0]]
    assert exp(x).tolist() == [math.exp(a) for a in x.tolist()]
    assert exp(np.empty((0, 3))).shape == (0, 3)
