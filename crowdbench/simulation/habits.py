"""Habits: what people do beside walking to their goals, in scenarios that ask for it.

Each habit is a compiled function of its own, and compiled only where a scenario has it. What is
drawn depends on the seed, the person and how often it has been drawn, never on robots.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.scenario import Pedestrians
from crowdbench.simulation.chipmunk import FUNCTIONS
from crowdbench.simulation.draws import ATTENTION, STOPS, between
from crowdbench.simulation.group_entry import bring_along
from crowdbench.simulation.groups import begin_groups, keep_together
from crowdbench.simulation.lanes import State
from crowdbench.simulation.layout import Layout
from crowdbench.simulation.motion import limit_changes
from crowdbench.simulation.queues import begin_queues, queue_up
from crowdbench.simulation.recorded import come_and_go, look_around
from crowdbench.simulation.traits import smallest

Lanes = NDArray[np.int64]
_UNIT = (0.0, 1.0)


class Habit(NamedTuple):
    """Something that is done in some lanes at every step.

    Attributes:
        has: whether a scenario asks for it.
        act: does it in the lanes (M,).
    """

    has: Callable[[Pedestrians], bool]
    act: Callable[[Lanes, State], None]


def begin_habits(
    people: NDArray[np.void], queues: NDArray[np.void], layout: Layout, settings: Pedestrians
) -> None:
    """Give people whose first legs have begun what their habits need.

    Args:
        people, queues: (P,), (Q,) records, written.
        layout: says what they are like.
        settings: of the scenario.
    """
    traits = layout.traits
    people["key"] = traits.key
    people["walks_on"] = settings.on_arrival == "new_goal" and not settings.recording.file
    people["looks"] = people["stops"] = 0
    people["attentive"] = True
    people["attention_time"] = people["stop_time"] = people["stop_end"] = np.inf
    people["stop_leg"] = np.nan
    reactive = layout.pedestrian_reactive
    count = round(settings.attention.away_share * np.count_nonzero(reactive))
    for p in np.flatnonzero(smallest(traits.attention, reactive, count)):
        first = between(_UNIT, people["key"][p], ATTENTION, 0)
        longest = settings.attention.every[1]
        people["attention_time"][p] = first * longest
    _stand(people, traits.standing, traits.facing)
    begin_queues(people, queues, traits, settings)
    begin_groups(people, traits.group)


def _stand(people: NDArray[np.void], who: NDArray[np.bool_], facing: NDArray[np.float64]) -> None:
    """Have some people stay where they are; pushed aside, they come back."""
    people["heading"][who], people["velocity"][who] = facing[who], 0.0
    for name in ("goal", "start", "next_goal"):
        people[name][who] = people["position"][who]
    people["switch_time"][who] = people["deadline"][who] = np.inf
    people["intent"][who] = 0
    people["walks_on"][who] = False


@compiled()
def attend(
    lanes: NDArray[np.int64],
    worlds: NDArray[np.void],
    people: NDArray[np.void],
    sees: NDArray[np.bool_],
) -> None:
    """Have people look away and back when it is time; who looks away sees no robot.

    Args:
        lanes: (M,) which.
        worlds, people, sees: of all lanes, see ``State``.
    """
    for i in range(len(lanes)):
        world = worlds[lanes[i]]
        for p in range(world.people):
            person = people[lanes[i], p]
            while world.time >= person.attention_time:
                person.looks += 1
                person.attentive = not person.attentive
                bounds = world.attentive_for if person.attentive else world.away_for
                lasts = between(bounds, person.key, ATTENTION, person.looks)
                person.attention_time += lasts
            if not person.attentive:
                for r in range(sees.shape[2]):
                    sees[lanes[i], p, r] = False


@compiled()
def stop(lanes: NDArray[np.int64], worlds: NDArray[np.void], people: NDArray[np.void]) -> None:
    """Have people stop on their way, at a moment that is drawn when a leg begins.

    Args:
        lanes: (M,) which.
        worlds, people: of all lanes, see ``State``.
    """
    for i in range(len(lanes)):
        world = worlds[lanes[i]]
        for p in range(world.people):
            person = people[lanes[i], p]
            if person.deadline == math.inf or 0 <= person.leader != p:
                continue  # on no leg, or on that of a group
            if person.deadline != person.stop_leg:  # every leg has another
                _plan_stop(person, world)
            if person.stop_time <= world.time < person.stop_end:
                person.preferred[0], person.preferred[1] = 0.0, 0.0


@compiled()
def _plan_stop(person, world):  # type: ignore[no-untyped-def]
    person.stop_time, person.stop_end = math.inf, math.inf
    if between(_UNIT, person.key, STOPS, 3 * person.stops) < world.stop_share:
        x, y = person.goal[0] - person.position[0], person.goal[1] - person.position[1]
        walk = math.sqrt(x * x + y * y) / max(person.speed, 0.05)
        when = between(_UNIT, person.key, STOPS, 3 * person.stops + 1)
        lasts = between(world.stop_for, person.key, STOPS, 3 * person.stops + 2)
        person.stop_time = world.time + when * walk
        person.stop_end = person.stop_time + lasts
        person.deadline += lasts
    person.stops += 1
    person.stop_leg = person.deadline


BEFORE_LEGS: Sequence[Habit] = (
    Habit(
        lambda people: people.model == "recorded",
        lambda lanes, s: look_around(lanes, s.worlds, s.robots, s.people, s.sees),
    ),
    Habit(
        lambda people: len(people.queues) > 0,
        lambda lanes, s: queue_up(lanes, s.worlds, s.people, s.queues),
    ),
)
"""Those that come before legs are chosen."""
BEFORE_CHOICE: Sequence[Habit] = (
    Habit(lambda people: people.stops.share > 0, lambda lanes, s: stop(lanes, s.worlds, s.people)),
    Habit(
        lambda people: people.groups.share > 0 and len(people.streams) > 0,
        lambda lanes, s: bring_along(
            lanes, s.worlds, s.robots, s.people, s.obstacles, s.walls, FUNCTIONS
        ),
    ),
    Habit(
        lambda people: people.groups.share > 0,
        lambda lanes, s: keep_together(lanes, s.worlds, s.people, s.obstacles, s.walls),
    ),
    Habit(
        lambda people: people.attention.away_share > 0,
        lambda lanes, s: attend(lanes, s.worlds, s.people, s.sees),
    ),
)
"""Those of the time between the choice of legs and that of velocities, in their order."""
AFTER_CHOICE: Sequence[Habit] = (
    Habit(
        lambda people: people.acceleration is not None,
        lambda lanes, s: limit_changes(lanes, s.worlds, s.people),
    ),
)
"""Those of the time before people move."""
AFTER_MOTION: Sequence[Habit] = (
    Habit(
        lambda people: people.model == "recorded",
        lambda lanes, s: come_and_go(lanes, s.worlds, s.robots, s.people, FUNCTIONS),
    ),
)
"""Those of the end of a control period."""


class HabitLanes:
    """In which lanes there is which habit."""

    def __init__(self, lanes: int) -> None:
        """No lane has any."""
        habits = (*BEFORE_LEGS, *BEFORE_CHOICE, *AFTER_CHOICE, *AFTER_MOTION)
        self._has = {habit: np.zeros(lanes, dtype=np.bool_) for habit in habits}
        self._found: set[Habit] = set()

    def note(self, lane: int, people: Pedestrians) -> None:
        """Take note of what a lane has from now on."""
        for habit, has in self._has.items():
            has[lane] = habit.has(people)
            (self._found.add if has.any() else self._found.discard)(habit)

    def act(self, habits: Sequence[Habit], lanes: Lanes, state: State) -> None:
        """Do what is to be done in those of the lanes that have these habits."""
        for habit in habits:
            if habit in self._found and len(having := lanes[self._has[habit][lanes]]):
                habit.act(having, state)
