"""How the simulated robot moves: the kinematics of turtlesim, and what each kind of robot makes of a command.

Used by robot.py, 62.5 times a second. Frame: metres, x to the right, y up, origin in the world's
lower left corner; theta in radians, counter-clockwise from x, in [-pi, pi). It knows no
clock: the caller says what time it is. A differential robot cannot move sideways and leaves `linear.y` out; an
Ackermann robot turns by steering.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from sim_robot.messages import Values

STEP_S = 0.016
COMMAND_TIMEOUT_S = 1.0
WHEELBASE_M = 0.5
STEERING_LIMIT_RAD = 0.6
TWIST, ACKERMANN = "geometry_msgs/Twist", "ackermann_msgs/AckermannDriveStamped"


@dataclass(frozen=True, slots=True)
class Velocity:
    """A commanded velocity in the robot's own frame: m/s forward, m/s to the left, rad/s."""

    linear_x: float = 0.0
    linear_y: float = 0.0
    angular_z: float = 0.0


@dataclass(frozen=True, slots=True)
class Pose:
    """Where the robot is: m, m, rad."""

    x: float
    y: float
    theta: float


STANDING = Velocity()


class Turtle:
    """One robot in a square world with walls."""

    def __init__(self, world_size_m: float) -> None:
        self._size_m = world_size_m
        self.start = Pose(world_size_m / 2, world_size_m / 2, 0.0)
        self.pose = self.start
        self.velocity = STANDING
        self.at_wall = False
        self._commanded_at_s = -math.inf

    def command(self, velocity: Velocity, now_s: float) -> None:
        """Take a new velocity; it holds until the next one, at most COMMAND_TIMEOUT_S."""
        self.velocity = velocity
        self._commanded_at_s = now_s

    def reset(self) -> None:
        """Stand still at the start again."""
        self.pose = self.start
        self.velocity = STANDING
        self.at_wall = False

    def step(self, now_s: float) -> None:
        """Move on by STEP_S."""
        if now_s - self._commanded_at_s > COMMAND_TIMEOUT_S:
            self.velocity = STANDING
        speed = self.velocity
        # turtlesim turns first and then moves along the new heading; the order shows in every pose.
        theta = _wrapped(self.pose.theta + speed.angular_z * STEP_S)
        cos, sin = math.cos(theta), math.sin(theta)
        x = self.pose.x + (cos * speed.linear_x - sin * speed.linear_y) * STEP_S
        y = self.pose.y + (sin * speed.linear_x + cos * speed.linear_y) * STEP_S
        self.at_wall = not (0.0 <= x <= self._size_m and 0.0 <= y <= self._size_m)
        self.pose = Pose(self._clamped(x), self._clamped(y), theta)

    def _clamped(self, value: float) -> float:
        return min(max(value, 0.0), self._size_m)


def _wrapped(theta: float) -> float:
    return theta - 2 * math.pi * math.floor((theta + math.pi) / (2 * math.pi))


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
    speed, angle = values["drive"]["speed"], values["drive"]["steering_angle"]
    if not math.isfinite(angle):
        return Velocity(speed, 0.0, angle)  # the robot refuses it
    steering = min(max(angle, -STEERING_LIMIT_RAD), STEERING_LIMIT_RAD)
    return Velocity(speed, 0.0, speed * math.tan(steering) / WHEELBASE_M)


DRIVETRAINS = {
    "differential": Drivetrain(TWIST, _differential),
    "holonomic": Drivetrain(TWIST, _holonomic),
    "ackermann": Drivetrain(ACKERMANN, _ackermann),
}
