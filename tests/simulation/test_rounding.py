"""Lengths, sums and functions against the standard library and exact fractions."""

import math
from fractions import Fraction

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench import parallel_env
from crowdbench.simulation.rounding import atan2, exp, length, sum_of_products

NUMBERS = st.floats(-1e3, 1e3, allow_subnormal=False).filter(lambda x: x == 0.0 or abs(x) > 1e-9)


@settings(deadline=None, max_examples=300)
@given(x=NUMBERS, y=NUMBERS)
def test_lengths_are_rounded_as_by_the_standard_library(x, y):
    assert length(x, y) == math.hypot(x, y)


@settings(deadline=None, max_examples=300)
@given(a=NUMBERS, b=NUMBERS, c=NUMBERS, d=NUMBERS)
def test_only_the_first_product_and_the_sum_are_rounded(a, b, c, d):
    assert sum_of_products(a, b, c, d) == float(Fraction(a * b) + Fraction(c) * Fraction(d))


def test_functions_of_arrays_are_those_of_the_standard_library_place_by_place():
    y, x = np.random.default_rng(0).uniform(-9, 9, (2, 100, 1)), np.linspace(-3, 3, 20)
    assert atan2(y[0], x).tolist() == [[math.atan2(b, a) for a in x.tolist()] for (b,) in y[0]]
    assert exp(x).tolist() == [math.exp(a) for a in x.tolist()]
    assert exp(np.empty((0, 3))).shape == (0, 3)


def test_people_set_off_as_every_processor_rounds_it():
    env = parallel_env("multimodal_fast")
    for seed in range(20):
        env.reset(seed=seed)
        state = env.state()
        names = ("position", "goal", "velocity", "speed")
        for at, goal, velocity, speed in zip(
            *(state[f"pedestrian_{name}"].tolist() for name in names), strict=True
        ):
            heading = math.atan2(goal[1] - at[1], goal[0] - at[0])
            assert velocity == [speed * math.cos(heading), speed * math.sin(heading)]
