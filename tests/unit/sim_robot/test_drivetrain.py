"""Each kind of robot reads its own commands."""

import math

import pytest
from sim_robot.drivetrain import DRIVETRAINS, STEERING_LIMIT_RAD, WHEELBASE_M
from sim_robot.kinematics import Velocity
from sim_robot.messages import MessageTypes, Values

TWIST = {"linear": {"x": 0.5, "y": 0.2, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": -0.3}}


def steered(speed: float, angle: float) -> Values:
    """An Ackermann command."""
    given = {"drive": {"speed": speed, "steering_angle": angle}}
    return MessageTypes(2).conform("ackermann_msgs/AckermannDriveStamped", given, 0)


def test_only_a_holonomic_robot_moves_sideways() -> None:
    """The same twist leads a differential robot ahead and a holonomic one to its left too."""
    assert DRIVETRAINS["differential"].velocity(TWIST) == Velocity(0.5, 0.0, -0.3)
    assert DRIVETRAINS["holonomic"].velocity(TWIST) == Velocity(0.5, 0.2, -0.3)


def test_ackermann_turns_by_its_wheelbase() -> None:
    """The turn is speed x tan(steering) / wheelbase, and none without speed."""
    read = DRIVETRAINS["ackermann"].velocity
    assert read(steered(1.0, 0.3)) == Velocity(1.0, 0.0, math.tan(0.3) / WHEELBASE_M)
    assert read(steered(-1.0, 0.3)).angular_z == pytest.approx(-math.tan(0.3) / WHEELBASE_M)
    assert read(steered(0.0, 0.3)) == Velocity()


def test_steering_has_an_end() -> None:
    """Beyond the limit the wheels stay at it."""
    read = DRIVETRAINS["ackermann"].velocity
    assert read(steered(1.0, 3.0)) == read(steered(1.0, STEERING_LIMIT_RAD))
    assert read(steered(1.0, -3.0)) == read(steered(1.0, -STEERING_LIMIT_RAD))


def test_no_number_is_no_steering() -> None:
    """NaN stays NaN, which the robot refuses as a whole."""
    assert math.isnan(DRIVETRAINS["ackermann"].velocity(steered(1.0, math.nan)).angular_z)
