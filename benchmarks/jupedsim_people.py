"""People who are moved by models of JuPedSim, for ``people.py``, which says how it is run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jupedsim
import numpy as np
import shapely
from numpy.typing import NDArray

from crowdbench.people import CrowdRecording


class ByJuPedSim:
    """People who are moved by a model of JuPedSim, with the parameters that it has by default."""

    def __init__(self, recording: CrowdRecording, name: str, radius: float, period: float) -> None:
        """Nobody is there.

        Args:
            recording: of the people.
            name: of the model, one of those below.
            radius: of everybody [m].
            period: for which people are moved at once [s].
        """
        models: dict[str, tuple[Callable[[], Any], Callable[..., Any]]] = {
            "collision_free_speed": (
                jupedsim.CollisionFreeSpeedModelV2,
                jupedsim.CollisionFreeSpeedModelV2AgentParameters,
            ),
            "anticipation_velocity": (
                lambda: jupedsim.AnticipationVelocityModel(rng_seed=0),
                jupedsim.AnticipationVelocityModelAgentParameters,
            ),
        }
        model, self._parameters = models[name]
        low, high = (np.asarray(end).tolist() for end in recording.extent)
        area = shapely.box(*low, *high).buffer(2.0)
        if recording.walls:
            outline, *holes = sorted(map(shapely.Polygon, recording.walls), key=lambda s: -s.area)
            area = outline.difference(shapely.union_all(holes))
        self._simulation = jupedsim.Simulation(model=model(), geometry=area)
        self._stage = self._simulation.add_direct_steering_stage()
        self._journey = self._simulation.add_journey(jupedsim.JourneyDescription([self._stage]))
        self._agents: dict[int, int] = {}
        self._radius, self._period = radius, period
        self.place = np.zeros((len(recording.people), 2))

    def enter(
        self, person: int, place: NDArray[np.float64], ahead: NDArray[np.float64], speed: float
    ) -> bool:
        """Somebody appears; false where others or walls are too near."""
        try:
            self._agents[person] = self._simulation.add_agent(
                self._parameters(
                    position=tuple(place.tolist()),
                    desired_speed=speed,
                    radius=self._radius,
                    journey_id=self._journey,
                    stage_id=self._stage,
                )
            )
        except RuntimeError:
            return False
        self.place[person] = place
        return True

    def leave(self, person: int) -> None:
        """Somebody is gone."""
        self._simulation.mark_agent_for_removal(self._agents.pop(person))

    def walk(self, there: NDArray[np.int64], goal: NDArray[np.float64], time: float) -> None:
        """Move those who are there towards their goals, for a period."""
        agents = [self._simulation.agent(self._agents[p]) for p in there.tolist()]
        for agent, target in zip(agents, goal.tolist(), strict=True):
            agent.target = tuple(target)
        self._simulation.iterate(round(self._period / self._simulation.delta_time()))
        self.place[there] = [self._simulation.agent(self._agents[p]).position for p in there]
