"""A canvas in metres: anti-aliased shapes on a surface of pygame."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pygame

Color = tuple[int, int, int]
Points = NDArray[np.floating]

WHITE, PAPER = (255, 255, 255), (246, 246, 244)

SUPERSAMPLING = 3
"""Shapes are drawn this many times larger in each direction, then averaged."""

MARGIN = 40
"""Space around the arena, holding the texts [px]."""

AREA = 620.0**2
"""Area that the arena takes [px^2], whatever its shape."""

LONGEST, NARROWEST = 1120.0, 520
"""Longest side of the arena and least width of the picture [px]."""


class View:
    """Where world coordinates fall on the picture."""

    def __init__(
        self, length: float, width: float, centre: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        self.length, self.width, self.centre = length, width, np.array(centre)
        self.scale = min(np.sqrt(AREA / (length * width)), LONGEST / max(length, width))
        wide = max(NARROWEST, round(length * self.scale) + 2 * MARGIN)
        high = round(width * self.scale) + 2 * MARGIN
        self.size = (wide + wide % 2, high + high % 2)  # video codecs want even sizes

    def pixels(self, points: Points) -> Points:
        """World positions (..., 2) [m] to enlarged picture coordinates (..., 2)."""
        centre = np.array(self.size) / 2
        return SUPERSAMPLING * (centre + self.scale * (points - self.centre) * (1, -1))

    def floor(self) -> tuple[Points, Points]:
        """Upper left and lower right corner of the arena, in enlarged picture coordinates."""
        corner = np.array([self.length, -self.width]) / 2
        return self.pixels(self.centre - corner), self.pixels(self.centre + corner)


class Brush:
    """Shapes in world coordinates on an enlarged surface."""

    def __init__(self, pygame: Any, view: View) -> None:
        self._pygame, self._view = pygame, view
        self._unit = SUPERSAMPLING * view.scale
        size = (SUPERSAMPLING * view.size[0], SUPERSAMPLING * view.size[1])
        self._surface = pygame.Surface(size, depth=32)
        self._surface.fill(PAPER)

    def disc(self, centre: Points, radius: float, color: Color) -> None:
        """A filled circle; lengths in metres, here and below."""
        at = self._view.pixels(centre)
        self._pygame.draw.circle(self._surface, color, at, max(1.0, radius * self._unit))

    def ring(self, centre: Points, radius: float, width: float, color: Color) -> None:
        """A circle of which only the outermost ``width`` is drawn."""
        at, thick = self._view.pixels(centre), max(1, round(width * self._unit))
        self._pygame.draw.circle(self._surface, color, at, radius * self._unit, thick)

    def polygon(self, corners: Points, color: Color) -> None:
        """A filled polygon (n, 2)."""
        self._pygame.draw.polygon(self._surface, color, self._view.pixels(corners))

    def line(self, start: Points, end: Points, width: float, color: Color) -> None:
        """A stroke with round ends."""
        across = np.subtract(end, start)[::-1] * (1, -1)
        across = across * (width / 2 / max(np.hypot(*across), 1e-9))
        self.polygon(np.array([start + across, end + across, end - across, start - across]), color)
        self.disc(start, width / 2, color)
        self.disc(end, width / 2, color)

    def glaze(self, corners: Points, color: Color, share: float) -> None:
        """A polygon on the floor through which everything beneath stays visible."""
        if len(corners) < 3:
            return
        low, high = self._view.floor()
        layer = self._pygame.Surface(high - low, self._pygame.SRCALPHA, 32)
        tint = (*color, round(255 * share))
        self._pygame.draw.polygon(layer, tint, self._view.pixels(corners) - low)
        self._surface.blit(layer, low)

    def finish(self) -> pygame.Surface:
        """The surface at its final size, anti-aliased."""
        return self._pygame.transform.smoothscale(self._surface, self._view.size)
