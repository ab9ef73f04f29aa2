"""Queues: people who stand in line, step forward, are served and walk away.

To every queue belongs one person more than stand in it. Whoever is first is served for a time of
its own and then walks about, also where others stop on arrival; at that moment the one who was away
until then joins the end, so that lines keep their length.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from crowdbench.compiled import compiled
from crowdbench.scenario import Pedestrians
from crowdbench.simulation.draws import SERVICE, between
from crowdbench.simulation.pedestrians import ARRIVAL, KEEP
from crowdbench.simulation.traits import Traits


def begin_queues(
    people: NDArray[np.void], queues: NDArray[np.void], traits: Traits, settings: Pedestrians
) -> None:
    """Have everybody who belongs to a queue stand in it, in the place where the layout put them.

    Args:
        people: (P,) records, written.
        queues: (Q,) records, written.
        traits: of the people.
        settings: of the scenario.
    """
    people["queue"], people["place"] = traits.queue, traits.place
    people["served_time"], people["served"] = np.inf, 0
    for q, queue in enumerate(settings.queues):
        record = queues[q]
        record["head"], record["facing"] = queue.head, queue.facing
        record["spacing"], record["service"] = queue.spacing, queue.service
        record["last"] = queue.count - 1
        for p in np.flatnonzero((traits.queue == q) & (traits.place >= 0)).tolist():
            people["velocity"][p] = 0.0
            people["heading"][p] = math.atan2(queue.facing[1], queue.facing[0])
            _take_place(people[p], record, int(traits.place[p]))


@compiled()
def queue_up(
    lanes: NDArray[np.int64],
    worlds: NDArray[np.void],
    people: NDArray[np.void],
    queues: NDArray[np.void],
) -> None:
    """Serve those who are first, close up, and call back those who are away.

    Args:
        lanes: (M,) which.
        worlds, people, queues: of all lanes, see ``State``.
    """
    for i in range(len(lanes)):
        lane, world = lanes[i], worlds[lanes[i]]
        for p in range(world.people):
            person = people[lane, p]
            if person.place < 0:
                continue
            queue = queues[lane, person.queue]
            x, y = person.goal[0] - person.position[0], person.goal[1] - person.position[1]
            there = math.sqrt(x * x + y * y) < ARRIVAL
            if there:
                person.heading = math.atan2(queue.facing[1], queue.facing[0])
            if person.place == 0 and there and person.served_time == math.inf:
                lasts = between(queue.service, person.key, SERVICE, person.served)
                person.served_time = world.time + lasts
                person.served += 1
            if world.time >= person.served_time:
                for other in range(world.people):
                    member = people[lane, other]
                    if member.queue == person.queue and other != p:
                        before = member.place - 1 if member.place >= 0 else queue.last
                        _take_place(member, queue, before)
                _leave(person, world.time)


@compiled()
def _take_place(person, queue, place):  # type: ignore[no-untyped-def]
    """Head for a place in line and stay there."""
    back = place * queue.spacing
    x, y = queue.head[0] - back * queue.facing[0], queue.head[1] - back * queue.facing[1]
    person.place = place
    person.start[0], person.start[1] = person.position[0], person.position[1]
    person.goal[0], person.goal[1] = x, y
    person.next_goal[0], person.next_goal[1] = x, y
    person.intent = KEEP
    person.switch_time, person.deadline = math.inf, math.inf
    person.walks_on = False


@compiled()
def _leave(person, time):  # type: ignore[no-untyped-def]
    """Begin a leg now."""
    person.place = -1
    person.served_time = math.inf
    person.walks_on = True
    person.deadline = time
