"""The robot moves as turtlesim does."""

import math

import pytest
from sim_robot.kinematics import STEP_S, Pose, Turtle, Velocity
from sim_robot.world import World


def drive(turtle: Turtle, velocity: Velocity, steps: int, start_s: float = 0.0) -> None:
    """Hold one velocity by commands that never time out."""
    for number in range(steps):
        turtle.command(velocity, start_s + number * STEP_S)
        turtle.step(start_s + number * STEP_S)


def closed_form(start: Pose, velocity: Velocity, steps: int) -> tuple[float, float]:
    """Sum the geometric series that turning first and moving then gives."""
    turn = velocity.angular_z * STEP_S
    way = complex(velocity.linear_x, velocity.linear_y) * STEP_S
    factor = complex(math.cos(turn), math.sin(turn))
    heading = complex(math.cos(start.theta), math.sin(start.theta))
    total = way * heading * factor * (1 - factor**steps) / (1 - factor)
    return start.x + total.real, start.y + total.imag


@pytest.mark.parametrize(
    "velocity", [Velocity(1.0, 0.0, 1.0), Velocity(-0.7, 0.0, 2.5), Velocity(0.5, 0.8, -0.3)]
)
def test_arc_is_the_closed_form_of_the_discrete_motion(velocity: Velocity) -> None:
    """After 300 steps the position is the sum of the series to 1e-9 m."""
    turtle = Turtle(50.0)
    drive(turtle, velocity, 300)
    assert (turtle.pose.x, turtle.pose.y) == pytest.approx(
        closed_form(turtle.start, velocity, 300), abs=1e-9
    )


def test_paper_spiral_meets_no_obstacle() -> None:
    """The open-loop spiral passes every obstacle by more than the robot's radius."""
    turtle, world = Turtle(20.0), World(20.0)
    for message in range(62):
        for _ in range(31 if message % 4 else 32):
            turtle.command(Velocity(1.0 + 0.05 * message, 0.0, 1.0), 0.0)
            turtle.step(STEP_S)
            around = (
                (turtle.pose.x + 0.4 * math.cos(a), turtle.pose.y + 0.4 * math.sin(a))
                for a in range(7)
            )
            assert not any(item.holds(*place) for item in world.obstacles for place in around)
