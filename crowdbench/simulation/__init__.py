"""The crowd: bodies, people, sensors and the environments built on them.

Versions of the world (``WORLD_VERSION``):

- 0.2: directions at the start are rounded as the C library does, on every processor.
- 0.1: first release.
"""

WORLD_VERSION = "0.2"
"""Version of the world, raised when the same scenario, seed and actions come to another episode.

Episodes of different versions are never compared, shown or counted together. Crowdbench's own
version has no part in it.
"""
