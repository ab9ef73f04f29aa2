"""The NeuPAN-like planner: what it does in cases where one can say what it should do."""

import numpy as np
import pytest
import shapely
import yaml
from crowdbench_agents.neupan.agent import FOLDER, MOVING_SCALE, Neupan, load_settings
from crowdbench_agents.neupan.dune import WeightsError
from crowdbench_agents.neupan.motion import RING_POINTS
from crowdbench_agents.neupan.nrmp import Nrmp, rollout

import crowdbench
from crowdbench.evaluation.rollout import run_episode
from crowdbench.simulation.lidar import beam_table, cast_rays

NOBODY = np.empty((0, 2))


def robot(**changes):
    scenario = crowdbench.load_scenario("unimodal_slow", **changes)
    return crowdbench.RobotSpec.from_scenario(scenario)


def agent_for(spec, **options):
    agent = Neupan(**options)
    agent.reset(spec, seed=0)
    return agent


def sense(spec, pose, velocity, goal, walls=(), people=NOBODY):
    lidar = np.empty(len(spec.lidar_angles), dtype=np.float32)
    discs = np.array([[*person, 0.25] for person in people], float).reshape(-1, 3)
    cast_rays(
        pose, beam_table(spec.lidar_angles), np.empty((0, 3)), discs,
        np.array(walls, float).reshape(-1, 4), spec.lidar_range, lidar,
    )  # fmt: skip
    c, s = np.cos(pose[2]), np.sin(pose[2])
    off = np.array(goal) - pose[:2]
    return crowdbench.Observation(
        lidar=lidar,
        velocity=np.array(velocity, dtype=np.float32),
        goal=np.array([c * off[0] + s * off[1], c * off[1] - s * off[0]], dtype=np.float32),
        pose=np.array(pose, dtype=np.float32),
    )


def drive(agent, spec, steps, goal, walls=(), person=None, person_velocity=(0.0, 0.0), start=None):
    """Poses (n, 3) until the goal, and the least clearance to walls and person [m]."""
    pose = np.zeros(3) if start is None else np.array(start, dtype=float)
    velocity, poses, clearance = np.zeros(2), [pose], np.inf
    lines = shapely.MultiLineString([((a, b), (c, d)) for a, b, c, d in walls])
    for k in range(steps):
        people = NOBODY
        if person is not None:
            people = np.array([person]) + k * spec.control_period * np.array([person_velocity])
        observation = sense(spec, pose, velocity, goal, walls, people)
        velocity = np.clip(agent.act(observation), *np.array([spec.speed, spec.turn_rate]).T)
        moved = rollout(velocity[None], spec.control_period)[1]
        c, s = np.cos(pose[2]), np.sin(pose[2])
        pose = pose + [c * moved[0] - s * moved[1], s * moved[0] + c * moved[1], moved[2]]
        poses.append(pose)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        body = shapely.Polygon(spec.corners @ np.array([[c, s], [-s, c]]) + pose[:2])
        if walls:
            clearance = min(clearance, body.distance(lines))
        if person is not None:
            after = people[0] + spec.control_period * np.array(person_velocity)
            clearance = min(clearance, body.distance(shapely.Point(after)) - 0.25)
        if np.hypot(*(pose[:2] - goal)) <= spec.goal_tolerance:
            break
    return np.array(poses), clearance


def arrived(poses, goal, spec):
    return np.hypot(*(poses[-1, :2] - goal)) <= spec.goal_tolerance


def test_free_space_is_crossed_on_the_straight_line_at_full_speed():
    spec = robot()
    poses, _ = drive(agent_for(spec), spec, 60, (6.0, 0.0))
    assert arrived(poses, (6.0, 0.0), spec)
    assert np.abs(poses[:, 1]).max() < 0.01
    assert len(poses) - 1 <= np.ceil((6.0 - 0.3) / 0.2) + 2


@pytest.mark.parametrize("goal", [(-4.0, 0.1), (0.0, -4.0), (0.4, 0.4)])
def test_goals_behind_beside_and_close_are_reached(goal):
    spec = robot()
    poses, _ = drive(agent_for(spec), spec, 60, goal)
    assert arrived(poses, goal, spec)


@pytest.mark.parametrize("bearing", [1.2, 2.0, -3.0])
def test_it_turns_on_the_spot_rather_than_drive_an_arc(bearing):
    spec = robot()
    goal = 4.0 * np.array([np.cos(bearing), np.sin(bearing)])
    poses, _ = drive(agent_for(spec), spec, 60, goal)
    assert arrived(poses, goal, spec)
    driven = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).sum()
    assert driven < 1.03 * (4.0 - spec.goal_tolerance) + 0.2
    # From the turn alone at 1.5 rad/s, then the way at 1 m/s.
    assert spec.control_period * len(poses) < abs(bearing) / 1.5 + 4.0 + 1.0


@pytest.mark.parametrize("exact", [False, True])
def test_a_wall_ahead_is_never_touched(exact):
    spec = robot()
    poses, clearance = drive(
        agent_for(spec, exact=exact), spec, 75, (6.0, 0.0), walls=[(2.0, -20.0, 2.0, 20.0)]
    )
    assert clearance > 0.02
    assert poses[:, 0].max() > 1.0


def wall_with_gap(width):
    return [(2.0, -20.0, 2.0, -width / 2), (2.0, width / 2, 2.0, 20.0)]


@pytest.mark.parametrize("width", [0.5, 0.8])
def test_a_gap_wider_than_the_robot_is_passed(width):
    """The footprint is 0.3 m wide, and 0.1 m is wanted on either side."""
    spec = robot()
    poses, clearance = drive(agent_for(spec), spec, 75, (5.0, 0.0), walls=wall_with_gap(width))
    assert arrived(poses, (5.0, 0.0), spec)
    assert clearance > 0.02


@pytest.mark.parametrize("width", [0.2, 0.28])
def test_a_gap_narrower_than_the_robot_is_refused(width):
    spec = robot()
    poses, clearance = drive(agent_for(spec), spec, 75, (5.0, 0.0), walls=wall_with_gap(width))
    assert poses[:, 0].max() < 2.0
    assert clearance > 0.0


@pytest.mark.parametrize("speed", [0.5, 1.0])
@pytest.mark.parametrize("ahead", [2.0, 3.0])
def test_somebody_who_crosses_and_looks_at_nobody_is_let_pass(speed, ahead):
    """On a collision course: at the crossing when the robot would be there."""
    spec = robot()
    poses, clearance = drive(
        agent_for(spec), spec, 75, (6.0, 0.0),
        person=(ahead, -speed * ahead), person_velocity=(0.0, speed),
    )  # fmt: skip
    assert arrived(poses, (6.0, 0.0), spec)
    assert clearance > 0.05


def test_static_prediction_takes_points_where_they_are():
    spec = robot()
    moving, static = agent_for(spec), agent_for(spec, predict="static")
    for k in range(6):
        person = np.array([[1.6, -1.5 + 0.2 * k]])
        observation = sense(spec, np.zeros(3), (0, 0), (6.0, 0.0), people=person)
        foresees, sees = moving.act(observation), static.act(observation)
    # Whoever walks 1 m/s will be in the way when the robot gets there, and is not yet.
    assert not np.allclose(foresees, sees, atol=0.05)


@pytest.mark.parametrize(
    "scan",
    [
        np.full(180, 6.0),
        np.full(180, np.inf),
        np.full(180, np.nan),
        np.zeros(180),
        np.full(180, 0.05),
        np.where(np.arange(180) == 0, 1.0, 6.0),
        np.where(np.arange(180) == 90, 0.3, 6.0),
    ],
)
def test_odd_scans_get_a_finite_action_within_limits(scan):
    spec = robot()
    agent = agent_for(spec)
    for _ in range(3):
        v, w = agent.act(
            crowdbench.Observation(
                lidar=scan.astype(np.float32),
                velocity=np.zeros(2, dtype=np.float32),
                goal=np.array([5.0, 0.0], dtype=np.float32),
                pose=np.zeros(3, dtype=np.float32),
            )
        )
        assert spec.speed[0] <= v <= spec.speed[1]
        assert spec.turn_rate[0] <= w <= spec.turn_rate[1]


@pytest.mark.parametrize("beams", [0, 1])
def test_a_scan_of_one_or_no_beam_works(beams):
    spec = robot(lidar={"beams": 1})
    spec = crowdbench.RobotSpec(**{**vars(spec), "lidar_angles": np.zeros(beams)})
    v, w = agent_for(spec).act(
        crowdbench.Observation(
            lidar=np.full(beams, 6.0, dtype=np.float32),
            velocity=np.zeros(2, dtype=np.float32),
            goal=np.array([5.0, 0.0], dtype=np.float32),
            pose=np.zeros(3, dtype=np.float32),
        )
    )
    assert v > 0.5
    assert w == pytest.approx(0.0, abs=0.05)


def test_failed_solves_brake_and_are_counted(monkeypatch):
    spec = robot(robots={"acceleration": [1.0, 2.0]})
    agent = agent_for(spec)
    monkeypatch.setattr(Nrmp, "solve", lambda self: None)
    observation = sense(spec, np.zeros(3), (0.5, -1.0), (5.0, 0.0))
    # 1 m/s^2 and 2 rad/s^2 for 0.2 s.
    assert agent.act(observation) == pytest.approx([0.3, -0.6])
    assert agent.act(sense(spec, np.zeros(3), (0.1, 0.1), (5.0, 0.0))) == pytest.approx([0.0, 0.0])
    counts = agent.diagnostics()
    assert counts["brakings"] == 2
    assert counts["failed_solves"] >= 2
    agent.reset(spec, seed=0)
    assert not any(agent.diagnostics().values())


def test_an_episode_without_any_solution_ends_at_the_time_limit_and_its_log_says_why(monkeypatch):
    env = crowdbench.parallel_env("unimodal_slow", time_limit=2.0, pedestrians={"count": 0})
    agent = crowdbench.AgentSpec.parse("neupan").make()
    monkeypatch.setattr(Nrmp, "solve", lambda self: None)
    (episode,) = run_episode(env, [agent], seed=900_000)
    assert episode.outcome == "timeout"
    assert episode.error is None
    assert episode.diagnostics["brakings"] == episode.steps == 10


def test_acceleration_limits_hold_from_the_first_action_on():
    spec = robot(robots={"acceleration": [0.5, 1.0]})
    agent, velocity = agent_for(spec), np.zeros(2)
    for _ in range(5):
        action = agent.act(sense(spec, np.zeros(3), velocity, (3.0, 3.0)))
        assert np.all(np.abs(action - velocity) <= np.array([0.1, 0.2]) + 1e-5)
        velocity = action


def test_a_robot_that_is_slow_to_react_keeps_farther_away_unless_settings_are_given(tmp_path):
    settings = tmp_path / "config.yaml"
    settings.write_text((FOLDER / "config.yaml").read_text())
    at_once, slow = robot(), robot(**{"robots.latency": 1})
    scales = [
        agent_for(spec, exact=True, config=config)._pan._moving_scale
        for spec, config in ((slow, None), (slow, str(settings)), (at_once, None))
    ]
    assert scales == [MOVING_SCALE, 0.55, 0.55]
    assert MOVING_SCALE < 0.55


def test_a_robot_that_is_slow_to_react_takes_a_person_with_a_lost_beam_for_one_body():
    at_once, slow = robot(), robot(**{"robots.latency": 1})
    seen = sense(at_once, np.zeros(3), (0.0, 0.0), (3.0, 0.0), people=[(2.0, 0.0)])
    seen.lidar[0] = at_once.lidar_range
    points = [agent_for(spec, exact=True)._look(seen, seen)[0] for spec in (at_once, slow)]
    assert len(points[1]) == RING_POINTS
    assert len(points[0]) != RING_POINTS


def test_a_frozen_robot_turns_towards_the_freest_direction():
    """In a dead end that is open behind the robot, with the goal beyond its end."""
    spec = robot()
    settings = load_settings()
    walls = [(0.5, -0.6, 0.5, 0.6), (-3.0, -0.6, 0.5, -0.6), (-3.0, 0.6, 0.5, 0.6)]
    agent = agent_for(spec)
    patience = round(settings.freeze_time / spec.control_period)
    standing = sense(spec, np.zeros(3), (0, 0), (4.0, 0.0), walls)
    for _ in range(patience - 1):
        agent.act(standing)
    assert agent.diagnostics()["recoveries"] == 0
    _, turn = agent.act(standing)
    assert agent.diagnostics()["recoveries"] == 1
    assert abs(turn) > 1.0


def test_the_same_episode_gets_the_same_actions():
    spec = robot()
    agent = agent_for(spec)
    runs = []
    for _ in range(2):
        agent.reset(spec, seed=0)
        poses, _ = drive(agent, spec, 15, (6.0, 0.0), person=(2.0, -1.0), person_velocity=(0, 0.8))
        runs.append(poses)
    assert np.array_equal(*runs)


def test_a_footprint_without_network_uses_the_closed_form_and_says_so():
    spec = robot(robots={"length": 0.8, "width": 0.5})
    agent = Neupan()
    with pytest.warns(UserWarning, match=r"trained for the footprint.*closed form"):
        agent.reset(spec, seed=0)
    assert agent.weights_sha256 is None
    poses, clearance = drive(agent, spec, 60, (4.0, 0.0), walls=wall_with_gap(1.2))
    assert arrived(poses, (4.0, 0.0), spec)
    assert clearance > 0.02


def test_results_can_say_which_weights_drove():
    """Before the first episode already: stored episodes are looked for by it."""
    spec = robot()
    assert Neupan().weights_sha256 == load_settings().weights_sha256
    assert Neupan(exact=True).weights_sha256 is None
    assert agent_for(spec).weights_sha256 == load_settings().weights_sha256
    assert agent_for(spec, exact=True).weights_sha256 is None


def write_config(path, **changes):
    document = yaml.safe_load((FOLDER / "config.yaml").read_text())
    path.write_text(yaml.safe_dump({**document, **changes}))
    return str(path)


def test_weights_other_than_the_expected_ones_are_refused(tmp_path):
    with pytest.raises(WeightsError, match="corrupted or replaced"):
        Neupan(config=write_config(tmp_path / "c.yaml", weights_sha256="0" * 64))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"horizon": 0}, "horizon 0"),
        ({"predict": "psychic"}, "predict 'psychic'"),
        ({"d_min": 0.7}, "d_min 0.7"),
        ({"eta": -1.0}, "eta -1.0"),
        ({"rho": 0.0}, r"rho 0\.0"),
        ({"moving_scale": 0.0}, r"moving_scale 0\.0"),
        ({"moving_scale": 1.5}, r"moving_scale 1\.5"),
        ({"colour": "red"}, "unknown settings: colour"),
    ],
)
def test_settings_that_cannot_work_are_refused_by_name(tmp_path, change, message):
    with pytest.raises(ValueError, match=rf"c\.yaml.*{message}"):
        Neupan(config=write_config(tmp_path / "c.yaml", **change))


def test_options_are_refused_by_name_too():
    with pytest.raises(ValueError, match=r"'iterations': expected a whole number >= 1 .*, got 0"):
        crowdbench.AgentSpec.parse("neupan:iterations=0").make()
