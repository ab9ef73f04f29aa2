"""Maps that tests share, as changes of a shipped scenario."""

from crowdbench.scenario import load_scenario

BORDER = [[-10, -6, 10, -6], [10, -6, 10, 6], [10, 6, -10, 6], [-10, 6, -10, -6]]
WALL = [[0, -6, 0, -1], [0, 1, 0, 6]]
"""Across the middle, with a gap of 2 m."""
PILLARS = [
    [[x - 0.3, y - 0.3], [x + 0.3, y - 0.3], [x + 0.3, y + 0.3], [x - 0.3, y + 0.3]]
    for x in (-5, 5)
    for y in (-3, 3)
]
HALL = {
    "arena.kind": "map",
    "arena.length": 20,
    "arena.width": 12,
    "arena.walls": [*BORDER, *WALL],
    "arena.polygons": PILLARS,
    "arena.regions": {"west": [-9, -5, -7, 5], "east": [7, -5, 9, 5]},
    "robots.start": "west",
    "robots.goal": "east",
}
"""Two rooms with two pillars each; the robot goes from one to the other."""


def hall(**changes):
    """The scenario with some fields changed, dots written as two underscores."""
    dotted = {key.replace("__", "."): value for key, value in changes.items()}
    return load_scenario("multimodal_fast", **{**HALL, **dotted})


ROOMS = {
    "arena.kind": "map",
    "arena.length": 8,
    "arena.width": 8,
    "arena.walls": [[-4, -4, 4, -4], [4, -4, 4, 4], [4, 4, -4, 4], [-4, 4, -4, -4], [0, -4, 0, 2]],
    "arena.polygons": [[[-2.3, 0], [-1.7, 0], [-2, 0.5]]],
    "arena.regions": {"left": [-3.5, -3.5, -0.5, 1], "right": [[0.5, -3.5], [3.5, -3.5], [3.5, 1]]},
    "robots.start": "left",
    "robots.goal": "right",
}
"""Two rooms side by side, as changes of any scenario."""
