"""NeuPAN-like planner: from LiDAR points straight to controls, model-based.

Points of the scan, predicted with their estimated velocities, go through the distance encoder
(dune.py) into a convex planner (nrmp.py); pan.py alternates the two. The path to follow is the
straight line to the goal, drawn anew from the robot at every step, at a speed that leaves it the
time to turn. A robot that has been standing still for a while turns towards the freest direction,
which the original lacks.
"""

from __future__ import annotations

import warnings
from collections import deque
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from crowdbench_agents.geometry.scan import ScanGeometry
from crowdbench_agents.geometry.steering import slow_to_react
from crowdbench_agents.geometry.under_way import CommandsUnderWay, into_frame, relative
from crowdbench_agents.neupan.dune import Array, Dune, Footprint, load_dune
from crowdbench_agents.neupan.motion import Tracker
from crowdbench_agents.neupan.nrmp import Limits, Weights
from crowdbench_agents.neupan.pan import Pan, Scene
from pydantic import Field, Strict

import crowdbench

Prediction = Literal["constant_velocity", "static"]

FOLDER = Path(__file__).parent
FROM_NOISE = {"group_gap": 0.12, "position_noise": 0.05}
"""How bodies are told apart and followed [m], for a robot that can be bought."""
MOVING_SCALE = 0.4
"""The setting of that name, unless a file is given, for a robot that cannot evade at once."""
FREE_ENOUGH = 2.0
"""Directions that are free for longer are all alike [m]."""


@dataclass(frozen=True)
class Settings:
    """What config.yaml says; units and meanings are given there."""

    weights: str
    weights_sha256: str
    exact: bool
    predict: Prediction
    horizon: int
    iterations: int
    tolerance: float
    line_search: bool
    swerves: tuple[float, ...]
    scan_points: int
    step_points: int
    reference_speed: float
    q_position: float
    q_heading: float
    p_speed: float
    proximal: float
    smooth: float
    eta: float
    rho: float
    d_min: float
    d_max: float
    moving_scale: float
    freeze_time: float
    freeze_distance: float
    recovery_time: float

    def __post_init__(self) -> None:
        """Refuse what cannot work.

        Raises:
            ValueError: a value out of range; the message names the setting.
        """
        if self.predict not in get_args(Prediction):
            raise ValueError(f"predict {self.predict!r}: expected one of {get_args(Prediction)}")
        for name in ("horizon", "iterations", "scan_points", "step_points"):
            value = getattr(self, name)
            if not isinstance(value, int) or value < 1:
                raise ValueError(f"{name} {value!r}: expected a whole number from 1")
        for name in ("rho", "reference_speed", "freeze_time"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} {getattr(self, name)!r}: expected more than 0")
        for name in ("tolerance", "q_position", "q_heading", "p_speed", "proximal", "smooth",
                     "eta", "freeze_distance", "recovery_time"):  # fmt: skip
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} {getattr(self, name)!r}: expected at least 0")
        if not 0 < self.moving_scale <= 1:
            raise ValueError(f"moving_scale {self.moving_scale!r}: expected more than 0, up to 1")
        if not 0 <= self.d_min <= self.d_max:
            raise ValueError(
                f"d_min {self.d_min}, d_max {self.d_max}: expected 0 <= d_min <= d_max"
            )


def load_settings(path: Path = FOLDER / "config.yaml") -> Settings:
    """Read a settings file.

    Raises:
        ValueError: a missing or unknown setting, or a value out of range; names the file.
    """
    document: Any = crowdbench.read_yaml(path)
    known = {field.name for field in fields(Settings)}
    if not isinstance(document, dict):
        raise ValueError(f"{path}: expected 'setting: value' lines")
    if odd := set(document) ^ known:
        raise ValueError(f"{path}: missing or unknown settings: {', '.join(sorted(map(str, odd)))}")
    try:
        return Settings(**{**document, "swerves": tuple(document["swerves"])})
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error


class Neupan(crowdbench.Agent):
    """Drives by proximal alternating minimisation; counts what went wrong."""

    version = "0.1.0"

    def __init__(
        self,
        exact: Annotated[bool | None, Strict()] = None,
        predict: Annotated[Prediction | None, Field()] = None,
        horizon: Annotated[int | None, Field(ge=1, le=100)] = None,
        iterations: Annotated[int | None, Field(ge=1, le=100)] = None,
        reference_speed: Annotated[float | None, Field(gt=0, le=20)] = None,
        config: Annotated[str | None, Strict()] = None,
    ) -> None:
        """Use the settings in ``config`` (default: config.yaml), some of them replaced.

        Raises:
            ValueError: a setting out of range.
            WeightsError: the weights are missing or not the ones expected.
        """
        self._own_settings = not config
        settings = load_settings(Path(config)) if config else load_settings()
        options: dict[str, Any] = {
            "exact": exact,
            "predict": predict,
            "horizon": horizon,
            "iterations": iterations,
            "reference_speed": reference_speed,
        }
        given = {key: value for key, value in options.items() if value is not None}
        self._settings = replace(settings, **given)
        # Named before the first episode: stored episodes are told apart by it.
        self.weights_sha256 = None if self._settings.exact else self._settings.weights_sha256
        # Also checked before it: an unusable file is refused before anything runs.
        s = self._settings
        self._dune = (
            None if s.exact else load_dune(FOLDER / "weights" / s.weights, s.weights_sha256)
        )

    def reset(self, robot: crowdbench.RobotSpec, seed: int) -> None:
        """Start an episode: build the planner for this robot, forget the bodies seen."""
        s = self._settings
        self._robot, self._slow = robot, slow_to_react(robot)
        limits = Limits(
            low=np.array([robot.speed[0], robot.turn_rate[0]]),
            high=np.array([robot.speed[1], robot.turn_rate[1]]),
            acceleration=None if robot.acceleration is None else np.array(robot.acceleration),
        )
        footprint = Footprint.from_corners(robot.corners)
        self._pan = Pan(
            footprint,
            self._encoder(footprint),
            robot.control_period,
            limits,
            Weights(*(getattr(s, name) for name in Weights._fields)),
            s.horizon,
            s.step_points,
            s.iterations,
            s.tolerance,
            s.line_search,
            MOVING_SCALE if self._slow and self._own_settings else s.moving_scale,
        )
        self._limits = limits
        self._tracker = Tracker(
            robot.lidar_angles,
            robot.lidar_range,
            robot.control_period,
            **(FROM_NOISE if self._slow else {}),
        )
        self._scan, self._under_way = ScanGeometry(robot), CommandsUnderWay(robot)
        self._controls = np.zeros((s.horizon, 2))
        patience = max(2, round(s.freeze_time / robot.control_period))
        self._positions: deque[Array] = deque(maxlen=patience)
        self._escape, self._escape_steps = 0.0, 0
        self._counts = dict.fromkeys(("brakings", "recoveries"), 0)

    def act(self, observation: crowdbench.Observation) -> crowdbench.Action:
        """Plan, and return the first control; brake when no plan could be made.

        The plan begins where the robot will be when that control begins to act.
        """
        s = self._settings
        ahead = self._under_way.foresee(observation)
        points, moving = self._look(observation, ahead)
        nearest = np.argsort(np.linalg.norm(points, axis=1))[: s.scan_points]
        velocity = ahead.velocity.astype(np.float64)
        bearing, length = self._path(ahead, points)
        speed = min(s.reference_speed, self._limits.high[0])
        period = self._robot.control_period
        # Turn first, then drive: a reference that runs ahead of the turn would call for an arc.
        wanted = self._reachable(self._drive(bearing, speed), velocity)[:, 0]
        along = np.minimum(np.cumsum(np.append(0.0, wanted)) * period, length)
        direction = np.array([np.cos(bearing), np.sin(bearing)])
        scene = Scene(
            points[nearest],
            moving[nearest],
            np.column_stack([along[1:, None] * direction, np.full(s.horizon, bearing)]),
            np.diff(along) / period,
            velocity,
        )
        starts = [np.concatenate([self._controls[1:], self._controls[-1:]])]
        if s.swerves:
            starts.append(self._drive(bearing, 0.0))
            starts += [self._drive(bearing + swerve, speed) for swerve in s.swerves]
        plan = self._pan.plan(scene, [self._reachable(start, velocity) for start in starts])
        if plan is None:
            self._counts["brakings"] += 1
            self._controls = self._braking(velocity)
        else:
            self._controls = plan.controls
        return self._under_way.send(self._controls[0])

    def diagnostics(self) -> dict[str, float]:
        """Failed solves, steps braked because none succeeded, recoveries from standing still."""
        return {"failed_solves": self._pan.failed_solves, **self._counts}

    def _encoder(self, footprint: Footprint) -> Dune | Footprint:
        """The network where there is one for this footprint, else the closed form."""
        s = self._settings
        self.weights_sha256 = None
        if self._dune is None:
            return footprint
        trained = self._dune.footprint.corners
        if trained.shape != footprint.corners.shape or not np.allclose(trained, footprint.corners):
            warnings.warn(
                f"{s.weights} was trained for the footprint {trained.tolist()}, this robot has "
                f"{footprint.corners.tolist()}: using the closed form",
                stacklevel=3,
            )
            return footprint
        self.weights_sha256 = s.weights_sha256
        return self._dune

    def _look(
        self, observation: crowdbench.Observation, ahead: crowdbench.Observation
    ) -> tuple[Array, Array]:
        """(N, 2) points [m] and their velocities [m/s] when the next control begins to act.

        Both are in the frame of the robot as it will be then, which ``ahead`` says.
        """
        here, there = observation.pose.astype(np.float64), ahead.pose.astype(np.float64)
        origin = self._scan.origin(here).astype(np.float32)
        scan = observation.lidar.astype(np.float64)
        points, moving = self._tracker.update(
            self._scan.bridged(scan) if self._slow else scan, origin
        )
        if self._settings.predict == "static":
            moving = np.zeros_like(moving)
        shift = relative(here, there)
        places = points + self._scan.offset + self._under_way.time * moving
        return into_frame(places, shift), into_frame(moving, np.array([0.0, 0.0, shift[2]]))

    def _path(self, observation: crowdbench.Observation, points: Array) -> tuple[float, float]:
        """Bearing [rad] and length [m] of the path: to the goal, or out of a freeze."""
        s, pose = self._settings, observation.pose.astype(np.float64)
        x, y = observation.goal.astype(np.float64)
        bearing = float(np.arctan2(y, x))
        self._positions.append(pose[:2])
        frozen = (
            len(self._positions) == self._positions.maxlen
            and np.linalg.norm(self._positions[-1] - self._positions[0]) < s.freeze_distance
        )
        if self._escape_steps == 0 and frozen:
            self._counts["recoveries"] += 1
            self._escape = pose[2] + self._freest(points, bearing)
            self._escape_steps = round(s.recovery_time / self._robot.control_period)
            self._positions.clear()
        if self._escape_steps > 0:
            self._escape_steps -= 1
            return float(self._escape - pose[2]), np.inf
        return bearing, float(np.hypot(x, y))

    def _freest(self, points: Array, bearing: float) -> float:
        """Direction of a beam along which the robot can drive farthest [rad]."""
        angles = self._robot.lidar_angles
        beams = np.column_stack([np.cos(angles), np.sin(angles)])
        ahead = points @ beams.T
        aside = np.abs(points[:, :1] * beams[:, 1] - points[:, 1:] * beams[:, 0])
        blocked = (ahead > 0) & (aside < self._robot.radius + self._settings.d_min)
        free = np.min(np.where(blocked, ahead, FREE_ENOUGH), axis=0, initial=FREE_ENOUGH)
        return float(angles[np.argmax(free + 0.01 * np.cos(angles - bearing))])

    def _drive(self, bearing: float, speed: float) -> Array:
        """(T, 2) controls that turn to a bearing [rad] and drive there at a speed [m/s]."""
        controls = np.zeros((self._settings.horizon, 2))
        period, heading = self._robot.control_period, 0.0
        for control in controls:
            off = (bearing - heading + np.pi) % (2 * np.pi) - np.pi
            wanted = speed * max(0.0, np.cos(off)), off / period
            control[:] = np.clip(wanted, self._limits.low, self._limits.high)
            heading += control[1] * period
        return controls

    def _reachable(self, controls: Array, velocity: Array) -> Array:
        """(T, 2) the controls nearest to given ones within the acceleration limits."""
        if self._limits.acceleration is None:
            return controls
        reach = self._limits.acceleration * self._robot.control_period
        reachable = np.empty_like(controls)
        for t, control in enumerate(controls):
            velocity = np.clip(control, velocity - reach, velocity + reach)
            reachable[t] = velocity
        return reachable

    def _braking(self, velocity: Array) -> Array:
        """(T, 2) controls that stop as fast as the robot can."""
        return self._reachable(np.zeros((self._settings.horizon, 2)), velocity)
