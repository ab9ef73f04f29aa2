"""Learned agents warn of a robot that is not the one they were trained with."""

import warnings

import pytest
from crowdbench_agents.learning.trained_robot import TrainedRobot

import crowdbench

PLAIN = crowdbench.load_scenario("multimodal_fast")
WHEELCHAIR = {
    "robots": {
        "length": 1.1, "width": 0.7, "speed": (-0.3, 1.2), "turn_rate": (-1.0, 1.0),
        "acceleration": (0.8, 1.6),
    }
}  # fmt: skip


def spec(changes):
    return crowdbench.RobotSpec.from_scenario(PLAIN.override(changes))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"robots.length": 0.5}, "footprint 0.5 x 0.3 m (in training 0.4 x 0.3 m)"),
        ({"robots.width": 0.45}, "footprint 0.4 x 0.45 m (in training 0.4 x 0.3 m)"),
        ({"robots.speed": (0.0, 1.4)}, "speed 0 to 1.4 m/s (in training 0 to 1 m/s)"),
        ({"robots.speed": (-0.2, 1.0)}, "speed -0.2 to 1 m/s (in training 0 to 1 m/s)"),
        (
            {"robots.turn_rate": (-2.0, 2.0)},
            "turn rate -2 to 2 rad/s (in training -1.5 to 1.5 rad/s)",
        ),
        (
            {"robots.acceleration": (0.5, 1.0)},
            "acceleration limits 0.5 m/s^2, 1 rad/s^2 (in training none)",
        ),
        ({"control_period": 0.1}, "control period 0.1 s (in training 0.2 s)"),
        ({"lidar.beams": 360}, "LiDAR beams 360 (in training 180)"),
        ({"lidar.field_of_view": 270}, "LiDAR field of view 270 deg (in training 360 deg)"),
        ({"lidar.range": 10}, "LiDAR range 10 m (in training 6 m)"),
        ({"robots.latency": 2}, "latency 2 control periods (in training 0 control periods)"),
        (
            {"lidar.mount": (0.1, 0, 0.5)},
            "LiDAR mount 0.1 m, 0 m, 0.5 rad (in training 0 m, 0 m, 0 rad)",
        ),
        (
            {"robots.drive": "omnidirectional"},
            "drive omnidirectional (in training differential)",
        ),
    ],
)
def test_each_difference_is_said_with_what_it_was_in_training(changes, said):
    assert TrainedRobot().differences(spec(changes)) == [said]
    assert not TrainedRobot.of(spec(changes)).differences(spec(changes))


@pytest.mark.parametrize("name", crowdbench.scenario_names("paper"))
def test_the_robot_of_the_shipped_scenarios_is_the_one_of_training(name):
    robot = crowdbench.RobotSpec.from_scenario(crowdbench.load_scenario(name))
    assert TrainedRobot().differences(robot) == []


@pytest.mark.parametrize("changes", [{"pedestrians": {"count": 12}, "robots.travel": 6}, {}])
def test_other_people_and_places_are_not_warned_of(changes):
    assert TrainedRobot().differences(spec(changes)) == []


@pytest.mark.parametrize("agent", ["sac", "tdmpc", "latent_planner"])
def test_learned_agents_warn_in_one_line_and_drive(agent):
    made = crowdbench.AgentSpec.parse(agent).make()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made.reset(spec({}), 0)
    robot = spec(WHEELCHAIR)
    with pytest.warns(UserWarning, match=rf"^the weights of {agent} .*another robot") as caught:
        made.reset(robot, 0)
    (warning,) = caught
    message = str(warning.message)
    assert "\n" not in message
    for part in ("footprint 1.1 x 0.7 m", "speed -0.3 to 1.2", "turn rate -1 to 1", "0.8 m/s^2"):
        assert part in message


def test_what_weights_say_of_their_robot_is_read_and_checked(tmp_path):
    path = tmp_path / "w.safetensors"
    robot = TrainedRobot.of(spec(WHEELCHAIR))
    assert TrainedRobot.from_training({"robot": robot.model_dump(mode="json")}, path) == robot
    assert TrainedRobot.from_training({"seed": 0}, path) == TrainedRobot()
    for odd in ({"wheels": 4}, {"beams": "many"}, "a robot", [1]):
        with pytest.raises(ValueError, match=r"w\.safetensors: robot: ") as caught:
            TrainedRobot.from_training({"robot": odd}, path)
        assert "\n" not in str(caught.value)
