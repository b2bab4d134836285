"""The spiral is the paper's, its ideal end is exact, and turtlesim's steps are turtlesim's."""

from __future__ import annotations

import math

import pytest
from paper import spiral_course
from paper.spiral_course import Change
from sim_robot.kinematics import STANDING, STEP_S, Pose, Velocity
from sim_robot.settings import SimSettings


def near(pose: Pose) -> object:
    return pytest.approx((pose.x, pose.y, pose.theta), abs=1e-9)


def test_the_whole_spiral_commands_the_papers_length_in_31_seconds() -> None:
    """62 intervals of half a second command 78.275 m."""
    wanted = spiral_course.velocities()
    assert spiral_course.commanded_m(wanted) == pytest.approx(78.275)
    assert spiral_course.punctual(wanted)[-1] == Change(31.0, STANDING)


def test_each_command_is_a_little_faster_and_turns_alike() -> None:
    """1.0, 1.05, 1.1 m/s ... at 1 rad/s."""
    first = spiral_course.velocities()[:3]
    assert [each.linear_x for each in first] == pytest.approx([1.0, 1.05, 1.1])
    assert {each.angular_z for each in first} == {1.0}


def test_a_shortened_spiral_has_the_first_commands() -> None:
    """20 s are the first 40 of them."""
    assert spiral_course.velocities_within(20) == spiral_course.velocities()[:40]


def test_a_full_turn_ends_where_it_began() -> None:
    """An arc of 2 pi is closed, and its half is two radii to the left."""
    full = spiral_course.along(spiral_course.START, Velocity(2.0, 0.0, 1.0), 2 * math.pi)
    half = spiral_course.along(spiral_course.START, Velocity(2.0, 0.0, 1.0), math.pi)
    assert (full.x, full.y) == pytest.approx((0, 0), abs=1e-9)
    assert (half.x, half.y) == pytest.approx((0, 4), abs=1e-9)


def test_without_a_turn_the_way_is_straight() -> None:
    """2 m/s for 3 s along the heading."""
    there = spiral_course.along(Pose(1.0, 1.0, math.pi / 2), Velocity(2.0, 0.0, 0.0), 3)
    assert (there.x, there.y) == pytest.approx((1, 7))


def test_the_way_ends_at_the_end() -> None:
    """The drawn way's last point is the closed form's end."""
    changes = spiral_course.punctual(spiral_course.velocities())
    end = spiral_course.end_of(changes)
    assert list(spiral_course.path_of(changes))[-1] == pytest.approx((end.x, end.y))


def test_the_spiral_fits_into_the_simulators_world() -> None:
    """Started in its middle, the robot keeps a metre from every wall."""
    room = SimSettings(name="test").world_size_m / 2 - 1
    changes = spiral_course.punctual(spiral_course.velocities())
    assert all(max(abs(x), abs(y)) < room for x, y in spiral_course.path_of(changes))


def test_fine_steps_would_come_to_the_exact_end() -> None:
    """What steps end at is off the exact end by less than what the last speed covers in two steps."""
    wanted = spiral_course.velocities()
    changes = spiral_course.punctual(wanted)
    exact = spiral_course.end_of(changes)
    most = 2 * STEP_S * wanted[-1].linear_x
    for end in spiral_course.stepped_ends(wanted, phases=16):
        assert math.dist((end.x, end.y), (exact.x, exact.y)) < most


def test_a_change_is_taken_at_the_next_step() -> None:
    """A robot told to go for 2.5 steps goes for two or three of them, as the phase wants."""
    changes = [Change(0.0, Velocity(1.0, 0.0, 0.0)), Change(2.5 * STEP_S, STANDING)]
    steps = {
        round(spiral_course.stepped_end(changes, phase * STEP_S).x / STEP_S)
        for phase in (0.0, 0.25, 0.75)
    }
    assert steps == {2, 3}


def test_a_pose_is_seen_from_the_start() -> None:
    """What is north of a robot that looks north is ahead of it."""
    seen = spiral_course.in_frame_of(Pose(3.0, 4.0, math.pi / 2), Pose(3.0, 6.0, math.pi))
    assert (seen.x, seen.y, seen.theta) == near(Pose(2.0, 0.0, math.pi / 2))
