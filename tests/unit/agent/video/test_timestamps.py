"""When a frame was taken, by the stamp that its source gave."""

from __future__ import annotations

import time

import pytest
from robotether_agent.video.timestamps import NEAR_S, Now, now, timestamp_of

ARRIVED = Now(robot_s=1000.0, wall_s=1_800_000_000.0, steady_s=900.0)


def test_a_camera_stamp_is_wall_time():
    """A frame that was stamped 0.2 s ago is that old."""
    assert timestamp_of(ARRIVED.wall_s - 0.25, ARRIVED) == (999.75, True)


def test_a_steady_stamp_is_the_servers_own():
    """CLOCK_MONOTONIC, which stands still while the robot sleeps, as newer ones for ROS 2 write it."""
    assert timestamp_of(ARRIVED.steady_s - 0.25, ARRIVED) == (999.75, False)


@pytest.mark.parametrize(
    "stamp_s",
    [None, 0.0, 12.5, ARRIVED.wall_s - NEAR_S - 1, ARRIVED.wall_s + 0.5, ARRIVED.steady_s + 1],
)
def test_other_stamps_say_nothing(stamp_s):
    """None, simulated time, another machine's clock, and what is yet to come: the arrival counts."""
    assert timestamp_of(stamp_s, ARRIVED) == (ARRIVED.robot_s, False)


def test_the_three_clocks_run():
    before = time.time()
    found = now()
    assert before <= found.wall_s <= time.time()
    assert found.robot_s >= found.steady_s - 1
