"""Maps as images: the convention of ROS's map_server, a YAML file beside a PGM or PNG picture.

What is dark is solid. Its outline is simplified to within a pixel and becomes polygons, so that a
scenario that was read needs the files no more, and its digest depends on what they show alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crowdbench.messages import printable, setting, short
from crowdbench.strict_yaml import YamlError, read_yaml

MOST_PIXELS = 16_000_000
LARGEST = 200
"""Side of the area [m]."""
_MODES = ("1", "L", "LA", "P", "RGB", "RGBA")
"""Of pictures with up to 8 bits a channel, as Pillow names them."""
_JOINT = 0.05
"""Half side of the square by which pixels that touch at a corner are joined [pixels]."""
_FINE, _COARSE = 0.75, 1.0
"""By how much an outline may be simplified: what is as thin as a pixel keeps its shape, but only
stairs of 45 degrees become straight; or all stairs do [pixels]."""
_SHARE = 0.1
"""Of its area by which a coarse outline may be smaller or larger."""
_DIGITS = 6
"""Decimals of a coordinate [m]."""


def read_map(path: Path) -> dict[str, Any]:
    """What a map's files say, as fields of ``Arena``: length, width, centre and polygons.

    Raises:
        ValueError: a file is missing, unreadable or not what it should be, a field of the YAML is
            missing or out of range, or the picture is too large.
    """
    place = printable(path)
    if not path.is_file():
        raise ValueError(f"{place} does not exist; allowed: a YAML file of map_server")
    try:
        document = read_yaml(path)
    except YamlError as error:
        raise ValueError(str(error)) from error
    if not isinstance(document, dict):
        raise ValueError(f"{place}: {setting(document)}; allowed: 'key: value' lines of map_server")

    def number(key: str, low: float, high: float, default: float | None = None) -> float:
        value = document.get(key, default)
        if value is None:
            raise ValueError(f"{place}: {key} is missing; allowed: a number, {low:g} to {high:g}")
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ValueError(f"{place}: {key}: {setting(value)}; allowed: {low:g} to {high:g}")
        if not low <= value <= high:
            raise ValueError(f"{place}: {key}: {setting(value)}; allowed: {low:g} to {high:g}")
        return float(value)

    resolution = number("resolution", 0.001, 10)  # m per pixel
    threshold = number("occupied_thresh", 0, 1, 0.65)
    negate = document.get("negate", 0)
    if isinstance(negate, bool) or negate not in (0, 1):
        raise ValueError(f"{place}: negate: {setting(negate)}; allowed: 0 or 1")
    mode = document.get("mode", "trinary")
    if mode not in ("trinary", "scale"):
        raise ValueError(
            f"{place}: mode: {setting(mode)}; allowed: trinary or scale, in which what is solid is "
            "darker than occupied_thresh"
        )
    x, y = _origin(document.get("origin", [0, 0, 0]), place)
    image = document.get("image")
    if not isinstance(image, str):
        raise ValueError(
            f"{place}: image: {setting(image)}; allowed: the name of a PGM or PNG file"
        )
    try:
        bright = _brightness(path.parent / image)
    except ValueError as error:
        raise ValueError(f"{place}: image: {error}") from error
    length, width = (resolution * side for side in reversed(bright.shape))
    if max(length, width) > LARGEST:
        raise ValueError(
            f"{place}: {length:g} x {width:g} m are too large; allowed: {LARGEST} m a side"
        )
    solid = (bright if negate else 1.0 - bright) > threshold
    corner = np.array([x, y])
    outlines = [corner + resolution * outline for outline in outlines_of(solid[::-1])]
    return {
        "length": round(length, _DIGITS),
        "width": round(width, _DIGITS),
        "centre": (round(x + length / 2, _DIGITS), round(y + width / 2, _DIGITS)),
        "polygons": [outline.round(_DIGITS).tolist() for outline in outlines],
    }


def _origin(value: Any, place: str) -> tuple[float, float]:
    """Where the picture's lower left corner is [m]."""
    numbers = value if isinstance(value, list) else []
    plain = all(isinstance(one, (int, float)) and not isinstance(one, bool) for one in numbers)
    if not (
        plain and len(numbers) == 3 and all(abs(one) < 9_000 for one in numbers) and not numbers[2]
    ):
        raise ValueError(
            f"{place}: origin: {setting(value)}; allowed: [x, y, yaw] (m) of the lower left "
            "corner, up to 9,000 m away, with a yaw of 0"
        )
    return float(numbers[0]), float(numbers[1])


def _brightness(path: Path) -> NDArray[np.float64]:
    """(H, W) from 0, black, to 1, white; rows from the top."""
    from PIL import Image, UnidentifiedImageError

    place = printable(path)
    if not path.is_file():
        raise ValueError(f"{place} does not exist; allowed: a PGM or PNG file")
    try:
        with Image.open(path) as image:
            if image.mode not in _MODES:
                raise ValueError(f"{place} has more than 8 bits; allowed: 8 bits a channel")
            if image.width * image.height > MOST_PIXELS:
                raise ValueError(
                    f"{place} has {image.width} x {image.height} pixels, which is too "
                    f"large; allowed: {MOST_PIXELS:,} pixels"
                )
            return np.asarray(image.convert("L"), dtype=np.float64) / 255
    except (UnidentifiedImageError, OSError, SyntaxError, Image.DecompressionBombError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(
            f"{place} cannot be read as a picture ({short(reason)}); allowed: PGM or PNG"
        ) from error


def outlines_of(solid: NDArray[np.bool_]) -> list[NDArray[np.float64]]:
    """Simple polygons (n, 2) that cover the solid pixels, in pixels, x right and y up.

    Pixels that touch at a corner hold together. Solids with holes are cut in two through each.

    Args:
        solid: (H, W), the lowest row first.
    """
    import shapely

    boxes = [_runs(solid), _joints(solid)]
    whole = shapely.unary_union(shapely.box(*np.concatenate(boxes).T))
    pieces = [_simplified(part) for part in _polygons_in(whole)]
    simple = [part for piece in pieces for part in _without_holes(piece)]
    return [np.array(shapely.normalize(part).exterior.coords)[:-1] for part in simple]


def _runs(solid: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(n, 4) boxes of the solid pixels, one for each run in a row."""
    edges = np.diff(np.pad(solid, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, begin = np.nonzero(edges == 1)
    _, end = np.nonzero(edges == -1)
    return np.column_stack([begin, row, end, row + 1]).astype(np.float64)


def _joints(solid: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(n, 4) small boxes where two solid pixels touch at a corner and nothing else is solid."""
    below, above = solid[:-1], solid[1:]
    rising = below[:, :-1] & above[:, 1:] & ~below[:, 1:] & ~above[:, :-1]
    falling = below[:, 1:] & above[:, :-1] & ~below[:, :-1] & ~above[:, 1:]
    y, x = np.nonzero(rising | falling)
    return np.column_stack([x - _JOINT, y - _JOINT, x + _JOINT, y + _JOINT]) + 1.0


def _polygons_in(shape: Any) -> list[Any]:
    """Polygons of a shape that may be a collection of all kinds."""
    if shape.geom_type == "Polygon":
        return [] if shape.is_empty else [shape]
    return [part for one in getattr(shape, "geoms", ()) for part in _polygons_in(one)]


def _simplified(polygon: Any) -> Any:
    """The same with fewer corners, coarsely if that halves them; what holds together still does."""
    import shapely

    fine, coarse = (shapely.simplify(polygon, tolerance) for tolerance in (_FINE, _COARSE))
    corners = [shapely.get_num_coordinates(outline) for outline in (fine, coarse)]
    alike = abs(coarse.area - polygon.area) <= _SHARE * polygon.area
    if alike and 2 * corners[1] <= corners[0] and _is_near(coarse, polygon):
        return coarse
    return fine if _is_near(fine, polygon) else polygon


def _is_near(simplified: Any, polygon: Any) -> bool:
    """Whether each corner is within a pixel of the simplified outline.

    GEOS takes the corner where an outline begins away last, and with it can exceed its tolerance.
    """
    import shapely

    corners = shapely.points(shapely.get_coordinates(polygon))
    outline = simplified.boundary
    shapely.prepare(outline)
    return bool(shapely.dwithin(outline, corners, 1.0 + 1e-9).all())


def _without_holes(polygon: Any) -> list[Any]:
    """The same area in polygons without holes, cut along vertical lines."""
    import shapely

    if not polygon.interiors:
        return [polygon]
    hole = polygon.interiors[0].bounds
    left, low, right, high = polygon.bounds
    cut = (hole[0] + hole[2]) / 2
    halves = [shapely.box(left, low, cut, high), shapely.box(cut, low, right, high)]
    parts = [part for half in halves for part in _polygons_in(polygon.intersection(half))]
    return [piece for part in parts for piece in _without_holes(part)]
