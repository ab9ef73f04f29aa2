"""What watching people in streams tells about their ways, for those who know how ways are drawn.

A person in a stream walks to a place in the next of the stream's regions, by the shortest way past
walls. Which stream that is shows by its direction, and so do the regions that lie behind. Where in
the next region the place lies is believed as goals are elsewhere
(``crowdbench_agents.informed.goals``): Bayes' rule on the squares of the region, each as likely as
people walk who have it next on their way. Where legs may be interrupted, what is believed moves
from the squares of the next region to those where people then go, at the rate at which it happens.

Numbers are rounded alike everywhere, as they decide plans.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from crowdbench_agents.informed.walks import likely_directions, taken, weigh

import crowdbench
from crowdbench.compiled import compiled

SLOWEST = 0.05
"""Slower people count as this fast [m/s]."""


class _Aims(NamedTuple):
    """Where somebody may be going, C squares.

    Attributes:
        place: (C, 2) middles [m].
        share: (C,) of the first squares, those of the next region, before anything is seen; else 0.
        turned: (C,) the same of where people go whose legs are interrupted; else 0.
        remaining: (C, N) of the ways from all way points, see ``crowdbench.Ways``.
        rest: length of the way beyond the next region [m].
    """

    place: np.ndarray
    share: np.ndarray
    turned: np.ndarray
    remaining: np.ndarray
    rest: float


class Streams:
    """What is believed of the ways of all people in streams, and futures drawn from it."""

    def __init__(self, state, period):
        """Begin an episode.

        Args:
            state: of the world as it begins.
            period: control period [s].
        """
        self._period = period
        self._ways = _ways_of(
            state["walls"].tobytes(), float(state["way_clearance"]), tuple(state["bounds"].tolist())
        )
        self._stops = [
            [squares[squares[:, 2] > 0.0] for squares in stops if (squares[:, 2] > 0.0).any()]
            for stops in state["stream_places"]
        ]
        self._switches = float(state["switch_probability"])
        self._known = {}
        people = len(state["pedestrian_position"])
        self._aims = [None] * people
        self._weights = [np.empty(0)] * people
        self._lasts = [np.empty(0)] * people
        self._begun = np.zeros(people)

    def update(self, state, before, likely, seen):
        """Watch a step.

        Args:
            state: of the world now.
            before: of the world a step ago, None as the episode begins.
            likely: (P, DIRECTIONS) how likely what was walked is for each preferred direction.
            seen: (P,) whose walk counts.
        """
        stage, start = state["pedestrian_stage"], state["pedestrian_start"]
        earlier = before or state
        first = None
        for p in np.flatnonzero(state["pedestrian_stream"] >= 0).tolist():
            new_leg = (start[p] != earlier["pedestrian_start"][p]).any()
            begins = before is None or new_leg or stage[p] != earlier["pedestrian_stage"][p]
            if begins:
                self._begin(p, state, earlier)
            elif self._switches > 0.0:
                passed = float(earlier["time"]) - self._begun[p]
                _turn(
                    self._weights[p], self._aims[p].share, self._aims[p].turned, self._lasts[p],
                    passed, self._period, self._switches,
                )  # fmt: skip
            if seen[p] and stage[p] >= 0:  # who waits stands
                # Who begins may have been elsewhere a step ago, and comes walking.
                if begins and first is None:
                    first = likely_directions(state, None, self._period, 0.0)
                place = (state if begins else earlier)["pedestrian_position"][p]
                step, aims = (first if begins else likely)[p], self._aims[p]
                ahead = self._ways.next_points(place, aims.place, aims.remaining)
                if not weigh(self._weights[p], aims.place, ahead, *place, step):
                    self._begin(p, state, earlier)

    def draw(self, state, draws, goal, next_goal, switch_time, way):
        """Write what may be of people in streams into futures.

        Args:
            state: of the world now.
            draws: (F, P, 4) in [0, 1): which square, whether the leg is interrupted, when, and
                where it then leads.
            goal, next_goal, switch_time: (F, P, 2), (F, P, 2), (F, P), written [m, s].
            way: (F, P, L, 2) next points, written [m].
        """
        now = float(state["time"])
        for p in np.flatnonzero(state["pedestrian_stream"] >= 0).tolist():
            aims, stage = self._aims[p], state["pedestrian_stage"][p]
            exits = np.ascontiguousarray(self._stops[state["pedestrian_stream"][p]][-1].T)
            for k, (which, whether, when, whereto) in enumerate(draws[:, p].tolist()):
                chosen = _pick(self._weights[p], which)
                place = goal[k, p] = next_goal[k, p] = aims.place[chosen]
                switch_time[k, p] = math.inf
                if stage < 0:  # it stands, and will be where it enters
                    way[k, p] = state["pedestrian_way"][p]
                    continue
                way[k, p] = self._points(state["pedestrian_position"][p], place, way.shape[2])
                if not aims.share[chosen]:  # it has turned
                    continue
                if aims.rest > 0.0:
                    goal[k, p] = next_goal[k, p] = exits[:2, _pick(exits[2], which)]
                lasts = self._lasts[p][chosen]
                over = min(1.0, (now - self._begun[p]) / lasts)
                still = self._switches * (1.0 - over) / (1.0 - self._switches * over + 1e-9)
                if whether < still:
                    switch_time[k, p] = self._begun[p] + (over + when * (1.0 - over)) * lasts
                    next_goal[k, p] = aims.place[_pick(aims.turned, whereto)]

    def _begin(self, p, state, earlier):
        """Believe of a person what is known of all who have the same regions ahead."""
        self._begun[p] = float(earlier["time"])
        stream, stage = int(state["pedestrian_stream"][p]), int(state["pedestrian_stage"][p])
        aims = self._aims_of(stream, stage)
        self._aims[p], place = aims, state["pedestrian_position"][p]
        whole = self._ways.next_points(place, aims.place, aims.remaining)[:, 2] + aims.rest
        # Who has no way goes straight.
        dx, dy = (aims.place - place).T
        whole = np.where(whole < math.inf, whole, np.sqrt(dx * dx + dy * dy))
        self._lasts[p] = np.maximum(whole / max(float(state["pedestrian_speed"][p]), SLOWEST), 1e-3)
        self._weights[p] = _off_obstacles(
            aims.place, aims.share, state["obstacles"], float(state["pedestrian_radius"][p])
        )

    def _aims_of(self, stream, stage):
        """Where people of a stream are going; at stage -1 it is where they enter."""
        if (stream, stage) not in self._known:
            stops = self._stops[stream]
            groups = [stops[1 + stage]]
            if stage >= 0 and self._switches > 0.0:
                others = [end[-1] for end in self._stops if end is not stops] or [stops[-1]]
                back = stops[0] * [1.0, 1.0, 0.5]
                groups += [back, *(other * [1.0, 1.0, 0.5 / len(others)] for other in others)]
            squares = np.concatenate(groups)
            place = np.ascontiguousarray(squares[:, :2])
            next_ones = np.arange(len(squares)) < len(groups[0])
            middles = [squares[len(squares) // 2, :2] for squares in stops[1 + max(stage, 0) :]]
            self._known[stream, stage] = _Aims(
                place,
                np.where(next_ones, squares[:, 2], 0.0),
                np.where(next_ones, 0.0, squares[:, 2]),
                np.array([self._ways.remaining(goal) for goal in place]),
                sum(self._ways.length(a, b) for a, b in pairwise(middles)),
            )
        return self._known[stream, stage]

    def _points(self, start, goal, most):
        """(most, 2) next points of the way from one place to another, the last one repeated."""
        path = self._ways.path(start, goal)[1:]
        if not len(path):
            path = goal[None]  # without a way people walk straight
        return path[np.minimum(np.arange(most), len(path) - 1)]


@lru_cache(maxsize=4)
def _ways_of(walls, clearance, bounds):
    """Of people among walls (bytes of (S, 4)), as episodes of a scenario share them."""
    walls = np.frombuffer(walls).reshape(-1, 4)
    return crowdbench.Ways(walls, np.empty((0, 3)), clearance, bounds)


@compiled()
def _off_obstacles(places, share, obstacles, radius):
    """(C,) the share of each place (C, 2) that no obstacle takes; of all if they take all."""
    left, total = np.empty(len(places)), 0.0
    for g in range(len(places)):
        left[g] = 0.0 if taken(places[g, 0], places[g, 1], obstacles, radius) else share[g]
        total += left[g]
    for g in range(len(places)):
        left[g] = left[g] / total if total > 0.0 else share[g]
    return left


@compiled()
def _turn(weights, share, turned, lasts, passed, period, probability):
    """Move what is believed of legs that are interrupted within a period, ``passed`` [s] after
    they began."""
    moved = 0.0
    for g in range(len(weights)):
        if share[g] > 0.0 and passed < lasts[g]:
            rate = probability * period / (lasts[g] - probability * passed)
            part = min(1.0, rate) * weights[g]
            weights[g] -= part
            moved += part
    for g in range(len(weights)):
        weights[g] += moved * turned[g]


@compiled()
def _pick(weights, draw):
    """Which of some things with weights, that add up to 1, a draw in [0, 1) means."""
    chosen, total = 0, 0.0
    for g in range(len(weights)):
        if weights[g] > 0.0:
            chosen = g
            total += weights[g]
            if total > draw:
                break
    return chosen
