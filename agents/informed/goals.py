"""What watching people tells about where they are going, for those who know how goals are drawn.

Goals are places in an area, drawn evenly at least a leg away from where a leg begins. Each person's
is believed to be in one of many cells. With every step a cell counts for as much as a person on its
way there would have walked as this one did: people walk by ORCA, whose velocities follow from what
everybody can see and from the preferred direction. Goals of legs, and when and how legs are
interrupted, are drawn from that belief: Bayes' rule on a grid (Thrun, Burgard and Fox,
"Probabilistic Robotics", 2005, section 4.1).

Where a leg began is taken to be known. Numbers are rounded alike everywhere, as they decide plans.
"""

from __future__ import annotations

import math

import numpy as np
from crowdbench_agents.informed.prediction import without_hidden
from crowdbench_agents.informed.stops import Stops
from crowdbench_agents.informed.streams import Streams
from crowdbench_agents.informed.walks import (
    ARRIVAL,
    CELL,
    likely_directions,
    taken,
    weigh,
)

from crowdbench.compiled import compiled

FURTHER = 2
"""Goals drawn for after the present leg."""
_TRIES = 8
"""Places drawn for a goal that has to be a leg away."""
_GOAL, _SIDE, _SWITCH, _WHEN, _KIND, _PLACES = 0, 1, 3, 4, 5, 6
_DRAWS = _PLACES + 2 * _TRIES * (1 + FURTHER)


class Goals:
    """What is believed of the goals of all pedestrians, and futures drawn from it."""

    def __init__(self, state, period, robot_radius, futures, rng):
        """Begin an episode.

        Args:
            state: of the world as it begins.
            period: control period [s].
            robot_radius: of the circle around a robot [m].
            futures: how many are drawn.
            rng: where draws come from.
        """
        if "recorded_ahead" in state:
            raise ValueError(
                "intent=sampled: people who walk as recorded have no goals to be drawn"
            )
        self._period, self._robot_radius, self._rng = period, robot_radius, rng
        length, width = state["goal_area"]
        x, y = (_middles(side) for side in (length, width))
        self._centre = (state["bounds"][:2] + state["bounds"][2:]) / 2
        self._cells = np.column_stack([np.repeat(x, len(y)), np.tile(y, len(x))]) + self._centre
        self._size = np.array([length / len(x), width / len(y)])
        people = len(state["pedestrian_position"])
        self._weights = np.zeros((people, len(self._cells)))
        self._draws = np.empty((futures, people, _DRAWS))
        self._begun, self._switched = np.zeros(people), np.zeros(people)
        self._stops = Stops(people, futures, rng) if state["stop_share"] > 0.0 else None
        in_streams = (state["pedestrian_stream"] >= 0).any()
        self._streams = Streams(state, period) if in_streams else None
        self._before = None

    def update(self, state, seen):
        """Watch a step.

        Args:
            state: of the world now.
            seen: (P,) whose walk counts.
        """
        before, start = self._before, state["pedestrian_start"]
        stood = _who_stands(before or state)
        walks_off = stood & ~_who_stands(state)
        for p in range(len(start)):
            if before is None or walks_off[p] or (start[p] != before["pedestrian_start"][p]).any():
                self._begin_leg(p, state, before, stood[p])
        likely = likely_directions(state, before, self._period, self._robot_radius)
        place = (before or state)["pedestrian_position"]
        straight = seen & (state["pedestrian_stream"] < 0)
        for p in np.flatnonzero(straight).tolist():
            if not weigh(self._weights[p], self._cells, self._cells, *place[p], likely[p]):
                self._believe_anything(p, state)
        if self._streams is not None:
            self._streams.update(state, before, likely, seen)
        self._before = state

    def draw(self, state):
        """States of the world, one for each future, with goals that may be the true ones."""
        futures, people = self._draws.shape[:2]
        goal, next_goal = np.empty((futures, people, 2)), np.empty((futures, people, 2))
        switch_time = np.empty((futures, people))
        further = np.empty((futures, people, FURTHER, 2))
        _draw(
            self._draws,
            self._weights,
            self._cells,
            self._size,
            float(state["time"]),
            self._begun,
            self._switched,
            float(state["switch_probability"]),
            float(state["least_leg"]),
            state["pedestrian_start"],
            state["pedestrian_speed"],
            state["goal_area"],
            self._centre,
            goal,
            next_goal,
            switch_time,
            further,
        )
        way = np.repeat(goal[:, :, None], state["pedestrian_way"].shape[1], axis=2)
        if self._streams is not None:
            chosen = self._draws[:, :, [_GOAL, _SWITCH, _WHEN, _PLACES]]
            self._streams.draw(state, chosen, goal, next_goal, switch_time, way)
            # They leave there.
            streams = state["pedestrian_stream"] >= 0
            further[:, streams] = goal[:, streams, None]
        # Who stands does so for all to see.
        stands = _who_stands(state)
        goal[:, stands] = next_goal[:, stands] = state["pedestrian_goal"][stands]
        way[:, stands] = goal[:, stands, None]
        told = without_hidden(state)
        if self._stops is None:
            stop = end = np.full((futures, people), np.inf)
        else:
            stop, end = self._stops.draw(state, self._begun, goal)
        return [
            {
                **told,
                "pedestrian_stop_time": stop[k],
                "pedestrian_stop_end": end[k],
                "pedestrian_goal": goal[k],
                "pedestrian_next_goal": next_goal[k],
                "pedestrian_switch_time": switch_time[k],
                "pedestrian_way": way[k],
                "pedestrian_further": further[k],
            }
            for k in range(futures)
        ]

    def _begin_leg(self, p, state, before, stood):
        """Believe of a person at the begin of a leg what is known of all."""
        now, probability = float(state["time"]), float(state["switch_probability"])
        x, y = state["pedestrian_start"][p]
        self._switched[p] = 0.0
        back_x, back_y = math.inf, math.inf
        if before is not None and probability > 0.0 and not stood:
            back_x, back_y = before["pedestrian_start"][p]
            pace = max(float(state["pedestrian_speed"][p]), 1e-3)
            arrived = _mass(self._weights[p], self._cells, x, y, ARRIVAL + pace * self._period)
            # Of a leg of some length: chance that it is interrupted in just this period.
            usual = (now - self._begun[p]) + float(state["least_leg"]) / pace
            interrupted = probability * self._period / usual
            self._switched[p] = interrupted / (interrupted + arrived)
        self._begun[p] = now if before is None else float(before["time"])
        self._believe_anything(p, state, back_x, back_y, 0.5 * self._switched[p])
        if self._stops is not None:
            self._stops.begin_leg(p)
        draws = self._draws[:, p]
        draws[:] = self._rng.random(draws.shape)
        # Evenly spread over what is believed.
        draws[:, _GOAL] = (self._rng.permutation(len(draws)) + draws[:, _GOAL]) / len(draws)

    def _believe_anything(self, p, state, back_x=math.inf, back_y=math.inf, back=0.0):
        """Believe all places alike that are a leg away, and ``back`` of it in one of them."""
        x, y = state["pedestrian_start"][p]
        _begin(
            self._weights[p], self._cells, x, y, float(state["least_leg"]), state["obstacles"],
            float(state["pedestrian_radius"][p]), back_x, back_y, back,
        )  # fmt: skip


def _who_stands(state):
    """(P,) who stays at its goal, or goes to a place that shows where it is, as in a queue."""
    return ~(state["pedestrian_walks_on"] | (state["pedestrian_group"] >= 0))


def _middles(side):
    """Middles of the cells along a side of the area."""
    count = max(1, math.ceil(side / CELL))
    return (np.arange(count) + 0.5) * (side / count) - side / 2


@compiled()
def _mass(weights, cells, x, y, reach):
    """What is believed of all cells within ``reach`` of a place."""
    total = 0.0
    for g in range(len(cells)):
        dx, dy = cells[g, 0] - x, cells[g, 1] - y
        if dx * dx + dy * dy < reach * reach:
            total += weights[g]
    return total


@compiled()
def _begin(weights, cells, x, y, leg, obstacles, radius, back_x, back_y, back):
    """Write the belief at (x, y), where a leg begins; ``back`` of it is in one place."""
    total, nearest, home = 0.0, math.inf, 0
    for g in range(len(cells)):
        dx, dy = cells[g, 0] - x, cells[g, 1] - y
        free = not taken(cells[g, 0], cells[g, 1], obstacles, radius)
        weights[g] = 1.0 if free and dx * dx + dy * dy >= leg * leg else 0.0
        total += weights[g]
        dx, dy = cells[g, 0] - back_x, cells[g, 1] - back_y
        if dx * dx + dy * dy < nearest:
            nearest, home = dx * dx + dy * dy, g
    for g in range(len(cells)):
        # Where no place is a leg away, goals are as far away as they can be: anywhere will do.
        weights[g] = (1.0 - back) * (weights[g] / total if total > 0.0 else 1.0 / len(cells))
    weights[home] += back


@compiled()
def _draw(
    draws,
    weights,
    cells,
    size,
    time,
    begun,
    switched,
    probability,
    leg,
    start,
    speed,
    area,
    centre,
    goal,
    next_goal,
    switch_time,
    further,
):
    """Write what the futures are: goal, next_goal, switch_time, further, see ``Goals.draw``."""
    for k in range(draws.shape[0]):
        for p in range(draws.shape[1]):
            u = draws[k, p]
            cell, total = len(cells) - 1, 0.0
            for g in range(len(cells)):
                total += weights[p, g]
                if total > u[_GOAL]:
                    cell = g
                    break
            x = cells[cell, 0] + (u[_SIDE] - 0.5) * size[0]
            y = cells[cell, 1] + (u[_SIDE + 1] - 0.5) * size[1]
            goal[k, p, 0], goal[k, p, 1] = x, y
            dx, dy = x - start[p, 0], y - start[p, 1]
            lasts = math.sqrt(dx * dx + dy * dy) / max(speed[p], 1e-3)
            over = min(1.0, (time - begun[p]) / max(lasts, 1e-3))
            still = probability * (1.0 - over) / (1.0 - probability * over + 1e-9)
            switch_time[k, p] = math.inf
            if u[_SWITCH] < (1.0 - switched[p]) * still:
                share = over + u[_WHEN] * (1.0 - over)
                switch_time[k, p] = begun[p] + share * lasts
                if u[_KIND] < 0.5:
                    x, y = start[p, 0], start[p, 1]
                else:
                    x, y = start[p, 0] + share * dx, start[p, 1] + share * dy
                    x, y = _a_leg_away(u[_PLACES : _PLACES + 2 * _TRIES], x, y, leg, area, centre)
            next_goal[k, p, 0], next_goal[k, p, 1] = x, y
            for i in range(FURTHER):
                first = _PLACES + 2 * _TRIES * (1 + i)
                x, y = _a_leg_away(u[first : first + 2 * _TRIES], x, y, leg, area, centre)
                further[k, p, i, 0], further[k, p, i, 1] = x, y


@compiled()
def _a_leg_away(places, x, y, leg, area, centre):
    """The first of the places at least a leg away from (x, y), else the farthest."""
    best_x, best_y, farthest = x, y, -1.0
    for k in range(len(places) // 2):
        px = centre[0] + (places[2 * k] - 0.5) * area[0]
        py = centre[1] + (places[2 * k + 1] - 0.5) * area[1]
        distance = math.sqrt((px - x) * (px - x) + (py - y) * (py - y))
        if distance > farthest:
            best_x, best_y, farthest = px, py, distance
        if distance >= leg:
            break
    return best_x, best_y
