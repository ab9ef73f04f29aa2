"""Lengths and sums against the standard library and exact fractions."""

import math
from fractions import Fraction

from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench import parallel_env
from crowdbench.simulation.rounding import length, sum_of_products

NUMBERS = st.floats(-1e3, 1e3, allow_subnormal=False).filter(lambda x: x == 0.0 or abs(x) > 1e-9)


@settings(deadline=None, max_examples=300)
@given(x=NUMBERS, y=NUMBERS)
def test_lengths_are_rounded_as_by_the_standard_library(x, y):
    assert length(x, y) == math.hypot(x, y)


@settings(deadline=None, max_examples=300)
@given(a=NUMBERS, b=NUMBERS, c=NUMBERS, d=NUMBERS)
def test_only_the_first_product_and_the_sum_are_rounded(a, b, c, d):
    assert sum_of_products(a, b, c, d) == float(Fraction(a * b) + Fraction(c) * Fraction(d))


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
