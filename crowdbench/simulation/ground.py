"""Ground: where among walls and solids a disc has room, in small square cells.

A cell is free for a disc if the disc fits wherever in the cell its centre is. So places are drawn
from the free cells without trying any, and a region without room is one without free cells.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.scenario import Arena
from crowdbench.scenario.places import Point, Region, corners
from crowdbench.scenario.room import rounded_up

CELL = 0.05
"""Side of a cell [m]; larger where the area is, so that there are not too many."""
_MOST_CELLS = 2_000_000
HALF_DIAGONAL = math.sqrt(0.5)
"""Of a square, by its side."""
_PER_METRE = 20
"""To one of so many parts widths in messages are rounded up."""
_ON_EDGE = 1e-9
"""Of a polygon is what is this near to it [m]."""

Mask = NDArray[np.bool_]


class Spots(NamedTuple):
    """Squares in which places are drawn, all alike likely.

    Attributes:
        corner: (N, 2) lower left corners [m].
        side: of every square [m]; 0 where these are points.
    """

    corner: NDArray[np.float64]
    side: float

    def draw(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        """(count, 2) places [m]."""
        draws = rng.random((count, 3))
        which = (draws[:, 0] * len(self.corner)).astype(np.int64)
        return self.corner[which] + self.side * draws[:, 1:]


class Ground:
    """The cells of an arena; masks of them are (rows, columns), the lowest row first.

    Attributes:
        bounds: x_min, y_min, x_max, y_max [m].
        side: of a cell [m].
        margin: from the centre of a cell to its corners [m].
        gap: (rows, columns) from a cell's centre to the nearest wall or border of the area, 0
            inside polygons [m].
    """

    def __init__(self, arena: Arena, walls: NDArray[np.float64], largest: float) -> None:
        """Measure every cell's gap.

        Args:
            arena: whose area and polygons.
            walls: (S, 4) all of them [m].
            largest: radius of a disc that will be asked for [m]; larger gaps are not told apart.
        """
        self.bounds = arena.bounds
        x_min, y_min, x_max, y_max = self.bounds
        self.side = max(CELL, math.sqrt((x_max - x_min) * (y_max - y_min) / _MOST_CELLS))
        self.margin = HALF_DIAGONAL * self.side
        self._x = x_min + self.side * (np.arange(int((x_max - x_min) / self.side + 1e-9)) + 0.5)
        self._y = y_min + self.side * (np.arange(int((y_max - y_min) / self.side + 1e-9)) + 0.5)
        self.gap = np.minimum(
            np.minimum(self._x - x_min, x_max - self._x),
            np.minimum(self._y - y_min, y_max - self._y)[:, None],
        )
        reach = largest + self.side
        np.minimum(self.gap, reach, out=self.gap)
        for wall in walls.tolist():
            self._measure(wall, reach)
        for polygon in arena.polygons:
            self.gap[self._inside(polygon)] = 0.0

    def free(self, radius: float) -> Mask:
        """Where a disc fits wherever in the cell its centre is."""
        return self.gap >= radius + self.margin

    def joining(self, gap: float) -> float:
        """Width of passages that join cells whose centres are ``gap`` from walls, whatever their
        shape [m].

        Narrower ones may. The centres of cells that a line crosses are half a diagonal away from
        it at most, and cells that it crosses one after another lie side by side.
        """
        return rounded_up(2 * (gap + self.margin), _PER_METRE)

    @property
    def holding(self) -> float:
        """Diameter of circles that have a cell inside, wherever they are [m].

        If the whole circle is as far from walls as a disc's radius, the disc has room in that cell.
        """
        return rounded_up(4 * self.margin, _PER_METRE)

    def connected(
        self, radius: float, discs: NDArray[np.float64] | None = None
    ) -> NDArray[np.int32]:
        """The same number in all cells between which a disc can move, 0 where it does not fit.

        A passage counts as wide enough if it is so but for a cell's side. Some ``discs`` (N, 3)
        x, y, radius [m] may be in the way.
        """
        from scipy import ndimage  # here, since few scenarios have regions

        free = self.gap >= radius
        for x, y, around in () if discs is None else discs.tolist():
            dx, dy = self._x - x, (self._y - y)[:, None]
            free &= np.sqrt(dx * dx + dy * dy) - around >= radius
        labels, _ = ndimage.label(free)
        return np.asarray(labels, dtype=np.int32)

    def within(self, region: Region) -> Mask:
        """Cells that lie in a region as a whole."""
        inside = np.ones(self.gap.shape, dtype=np.bool_)
        half = self.side / 2
        for dx, dy in ((-half, -half), (-half, half), (half, -half), (half, half)):
            inside &= self._inside(corners(region), dx, dy)
        return inside

    def at(self, point: tuple[float, float]) -> Mask:
        """The cells whose centres are nearest to a point, less than a cell's side away."""
        near_x = np.abs(self._x - point[0]) <= self.side
        near_y = np.abs(self._y - point[1]) <= self.side
        return near_x & near_y[:, None]

    def holds(self, mask: Mask, places: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(K,) whether places (K, 2) [m] lie in cells of a mask."""
        column = np.floor((places[:, 0] - self.bounds[0]) / self.side).astype(np.int64)
        row = np.floor((places[:, 1] - self.bounds[1]) / self.side).astype(np.int64)
        rows, columns = mask.shape
        known = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        found = np.zeros(len(places), dtype=np.bool_)
        found[known] = mask[row[known], column[known]]
        return found

    def spots(self, mask: Mask) -> Spots:
        """Where places in the cells of a mask are drawn."""
        row, column = np.nonzero(mask)
        lowest = np.column_stack([self._x[column], self._y[row]]) - self.side / 2
        return Spots(lowest, self.side)

    def _measure(self, wall: list[float], reach: float) -> None:
        """Note a wall where it is nearer than all before and than ``reach`` [m]."""
        x1, y1, x2, y2 = wall
        columns = self._between(self._x, min(x1, x2) - reach, max(x1, x2) + reach)
        rows = self._between(self._y, min(y1, y2) - reach, max(y1, y2) + reach)
        x, y = self._x[columns] - x1, (self._y[rows] - y1)[:, None]
        ex, ey = x2 - x1, y2 - y1
        square = ex * ex + ey * ey  # 0 where a wall is too short for its square
        share = np.clip((x * ex + y * ey) / square, 0.0, 1.0) if square > 0.0 else 0.0
        dx, dy = x - share * ex, y - share * ey
        window = self.gap[rows, columns]
        np.minimum(window, np.sqrt(dx * dx + dy * dy), out=window)

    @staticmethod
    def _between(centres: NDArray[np.floating], low: float, high: float) -> slice:
        return slice(*np.searchsorted(centres, [low, high]).tolist())

    def _inside(self, polygon: tuple[Point, ...], dx: float = 0.0, dy: float = 0.0) -> Mask:
        """Cells whose centre, moved by (dx, dy) [m], lies within a polygon or on its edge."""
        import shapely  # here, since few scenarios have regions

        x, y = np.meshgrid(self._x + dx, self._y + dy)
        return np.asarray(shapely.contains_xy(shapely.Polygon(polygon).buffer(_ON_EDGE), x, y))
