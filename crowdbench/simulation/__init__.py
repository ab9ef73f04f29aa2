"""The crowd: bodies, people, sensors and the environments built on them."""

WORLD_VERSION = "0.2"
"""Version of the world, raised when the same scenario, seed and actions come to another episode.

Episodes of different versions are never compared, shown or counted together. Crowdbench's own
version has no part in it.
"""
