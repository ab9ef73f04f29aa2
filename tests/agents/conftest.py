"""Small exact worlds to try LiDAR agents in, apart from the simulation."""

import dataclasses

import numpy as np
import pytest
import shapely
import torch
from crowdbench_agents.geometry.steering import reachable
from crowdbench_agents.learning import precision
from crowdbench_agents.learning.config import load_config

import crowdbench
from crowdbench.simulation.lidar import beam_table, cast_rays


class LidarWorld:
    """The default robot among discs and walls."""

    spec = crowdbench.RobotSpec.from_scenario(crowdbench.Scenario(name="test"))

    def scan(self, pose, discs, walls=()):
        """(beams,) float32 distances to discs (N, 3) and walls (S, 4)."""
        out = np.empty(len(self.spec.lidar_angles), dtype=np.float32)
        nobody, discs = np.empty((0, 3)), np.array(discs, dtype=float).reshape(-1, 3)
        walls = np.array(walls, dtype=float).reshape(-1, 4)
        beams, pose = beam_table(self.spec.lidar_angles), np.array(pose, dtype=float)
        cast_rays(pose, beams, nobody, discs, walls, self.spec.lidar_range, out)
        return out

    def observe(self, pose, discs, walls=(), goal=(5.0, 0.0), velocity=(0.0, 0.0)):
        """What a robot at ``pose`` senses."""
        others = (np.array(a, np.float32) for a in (velocity, goal, pose))
        return crowdbench.Observation(self.scan(pose, discs, walls), *others)

    def drive(self, agent, goal, discs=(), velocities=(), walls=(), steps=100):
        """Drive from the origin among discs that keep their velocities: (T, 3) poses, outcome."""
        pose, action = np.zeros(3), np.zeros(2)
        discs = np.array(discs, dtype=float).reshape(-1, 3)
        velocities = np.array(velocities, dtype=float).reshape(-1, 2)
        spec = self.spec
        agent.reset(spec, 0)
        path = [pose]
        box = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [spec.length / 2, spec.width / 2]
        for _ in range(steps):
            c, s = np.cos(pose[2]), np.sin(pose[2])
            frame = np.array([[c, -s], [s, c]])
            seen = self.observe(pose, discs, walls, (goal - pose[:2]) @ frame, action)
            asked = np.clip(agent.act(seen), [0.0, -1.5], [1.0, 1.5])
            action = np.array(reachable(spec, asked, action))
            for _ in range(10):
                dt = spec.control_period / 10
                middle = pose[2] + action[1] * dt / 2
                ahead = np.array([np.cos(middle), np.sin(middle)])
                pose = pose + dt * np.array([*(action[0] * ahead), action[1]])
                discs[: len(velocities), :2] += dt * velocities
                c, s = np.cos(pose[2]), np.sin(pose[2])
                robot = shapely.Polygon(box @ np.array([[c, s], [-s, c]]) + pose[:2])
                for x, y, r in discs:
                    if robot.distance(shapely.Point(x, y)) < r:
                        return np.array(path), "collision"
                for wall in walls:
                    if robot.intersects(shapely.LineString(np.reshape(wall, (2, 2)))):
                        return np.array(path), "collision"
            path.append(pose)
            if np.hypot(*(goal - pose[:2])) < spec.goal_tolerance:
                return np.array(path), "success"
        return np.array(path), "timeout"

    def random_observation(self, rng):
        """A first scan of some discs at rest."""
        count = rng.integers(0, 5)
        angles, distances = rng.uniform(-np.pi, np.pi, count), rng.uniform(0.8, 4, count)
        places = distances[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        discs = np.column_stack([places, np.full(count, 0.25)])
        goal = (rng.uniform(1, 6), rng.uniform(-1, 1))
        return self.observe((0.0, 0.0, 0.0), discs, goal=goal, velocity=(rng.uniform(0, 1), 0.0))

    def mirrored(self, seen):
        """The same with left and right exchanged."""
        return crowdbench.Observation(
            np.roll(seen.lidar[::-1], 1),
            seen.velocity * np.array([1, -1], np.float32),
            seen.goal * np.array([1, -1], np.float32),
            seen.pose * np.array([1, -1, -1], np.float32),
        )


@pytest.fixture(scope="session")
def world():
    """A small exact world to try LiDAR agents in."""
    return LidarWorld()


@pytest.fixture(scope="session")
def slow_world():
    """The same, with limits on the robot's acceleration."""
    world = LidarWorld()
    world.spec = dataclasses.replace(world.spec, acceleration=(1.0, 3.0))
    return world


@pytest.fixture
def small():
    """Configuration fields that make networks and runs small, whatever is trained."""
    return {
        "perception.cells": 16, "model.latent": 32, "model.hidden": 32, "training.environments": 4,
        "training.replay": 2000, "training.warmup": 60, "training.validation_episodes": 1,
        "training.bfloat16": False,
    }  # fmt: skip


@pytest.fixture
def tiny(overrides):
    """Makes a small configuration of what a folder's tests are about, with changes."""

    def make(**changes):
        return load_config().override(overrides | changes)

    return make


@pytest.fixture
def in_empty_folder(tmp_path, monkeypatch):
    """An empty working folder, and two scenarios to train in."""
    monkeypatch.chdir(tmp_path)
    names = ["unimodal_slow", "corridor_sparse"]
    monkeypatch.setattr(crowdbench, "scenario_names", lambda tier: names)
    return tmp_path


@pytest.fixture(params=[True, False], ids=["with bfloat16", "without bfloat16"])
def instructions(request, monkeypatch):
    """Whether the CPU is made to have instructions for bfloat16."""
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: request.param)
    monkeypatch.setattr(precision, "_onednn_uses_bfloat16", lambda: True)
    return request.param


@pytest.fixture
def arithmetic():
    """Tells the type of what an encoder's second convolution returns while something is done."""

    def watch(encoder, do):
        seen = []
        layer = encoder.f_map[2]
        with layer.register_forward_hook(lambda *call: seen.append(call[-1].dtype)):
            do()
        return set(seen)

    return watch
