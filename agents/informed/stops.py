"""Stops on the way, for those who know how they are drawn, but not when anybody will stop.

That somebody stands, and has stood since then, is seen by everybody.
"""

from __future__ import annotations

import numpy as np

_WHETHER, _WHEN, _LASTS = range(3)


class Stops:
    """Possible stops of all pedestrians, in each of several futures."""

    def __init__(self, people, futures, rng):
        """Begin an episode.

        Args:
            people: how many.
            futures: how many.
            rng: where draws come from.
        """
        self._rng = rng
        self._draws = np.empty((futures, people, 3))
        self._stopped = np.zeros(people, dtype=bool)

    def begin_leg(self, p):
        """Draw what may be of a leg that begins."""
        self._stopped[p] = False
        self._draws[:, p] = self._rng.random((len(self._draws), 3))

    def draw(self, state, begun, goal):
        """When people stop and walk on.

        Args:
            state: of the world now.
            begun: (P,) when each person's leg began [s].
            goal: (F, P, 2) where it leads, in each future [m].

        Returns:
            (F, P) begins and ends of stops, inf where there is none [s].
        """
        now, share = float(state["time"]), float(state["stop_share"])
        since = state["pedestrian_stop_time"]
        stands = (since <= now) & (now < state["pedestrian_stop_end"])
        self._stopped |= stands
        shortest, longest = state["stop_duration"]
        u = self._draws
        way = goal - state["pedestrian_start"]
        walk = np.sqrt(way[..., 0] ** 2 + way[..., 1] ** 2)
        walk = walk / np.maximum(state["pedestrian_speed"], 0.05)
        over = np.minimum(1.0, (now - begun) / np.maximum(walk, 1e-3))
        still = share * (1.0 - over) / (1.0 - share * over + 1e-9)
        stops = (u[..., _WHETHER] < still) & ~self._stopped
        begin = np.where(stops, begun + (over + u[..., _WHEN] * (1.0 - over)) * walk, np.inf)
        end = begin + shortest + u[..., _LASTS] * (longest - shortest)
        # Who has stood for some time will have stood for as long at least.
        least = np.maximum(shortest, now - np.where(stands, since, now))
        stood = np.where(stands, since, 0.0) + least + u[..., _LASTS] * (longest - least)
        return np.where(stands, since, begin), np.where(stands, stood, end)
