"""Noise that stays alike from one step to the next, so that it moves a robot somewhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class CorrelatedNoise:
    """Gaussian noise of zero mean, a first-order autoregression in time (red noise).

    Args:
        shape: of one step's noise.
        std: standard deviation once it has run for a while; it starts from zero.
        correlation: between one step and the next, 0 to 1.
        rng: of all draws.
    """

    def __init__(
        self, shape: tuple[int, ...], std: float, correlation: float, rng: np.random.Generator
    ) -> None:
        self._value = np.zeros(shape)
        self._correlation, self._rng = correlation, rng
        self._fresh_std = std * np.sqrt(1 - correlation**2)

    def step(self) -> NDArray[np.float64]:
        """The next step's noise, of the given shape."""
        fresh = self._rng.normal(scale=self._fresh_std, size=self._value.shape)
        self._value = self._correlation * self._value + fresh
        return self._value
