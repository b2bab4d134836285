"""The kinds of robot: which message each takes on /cmd_vel, and which velocity that is.

Used by robot.py. A differential robot cannot move sideways and leaves `linear.y` out; an Ackermann robot turns by
steering.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from sim_robot.kinematics import Velocity
from sim_robot.messages import Values

WHEELBASE_M = 0.5
STEERING_LIMIT_RAD = 0.6
TWIST, ACKERMANN = "geometry_msgs/Twist", "ackermann_msgs/AckermannDriveStamped"


@dataclass(frozen=True, slots=True)
class Drivetrain:
    """The type of a command, and how it is read."""

    command_type: str
    velocity: Callable[[Values], Velocity]


def _differential(values: Values) -> Velocity:
    return Velocity(values["linear"]["x"], 0.0, values["angular"]["z"])


def _holonomic(values: Values) -> Velocity:
    return Velocity(values["linear"]["x"], values["linear"]["y"], values["angular"]["z"])


def _ackermann(values: Values) -> Velocity:
    speed, wanted = values["drive"]["speed"], values["drive"]["steering_angle"]
    if not math.isfinite(wanted):
        return Velocity(speed, 0.0, wanted)  # the robot refuses it
    steering = min(max(wanted, -STEERING_LIMIT_RAD), STEERING_LIMIT_RAD)
    return Velocity(speed, 0.0, speed * math.tan(steering) / WHEELBASE_M)


DRIVETRAINS = {
    "differential": Drivetrain(TWIST, _differential),
    "holonomic": Drivetrain(TWIST, _holonomic),
    "ackermann": Drivetrain(ACKERMANN, _ackermann),
}
