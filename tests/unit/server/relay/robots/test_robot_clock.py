"""Clocks that are not synchronised, without a network."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_server.relay.robots.robot_clock import (
    MAX_SAMPLES,
    WINDOW_S,
    RobotClock,
    WindowedMaximum,
)

timestamps = st.floats(0, 1e6)


@given(st.lists(st.tuples(st.floats(0, 5), st.integers(-100, 100)), max_size=30))
def test_it_is_what_a_look_at_all_values_finds(steps):
    """Whatever the order of values, the window's greatest comes out."""
    maximum, all_of_them, now = WindowedMaximum(10), [], 0.0
    for pause, value in steps:
        now += pause
        maximum.add(now, value)
        all_of_them.append((now, value))
        assert maximum.at(now) == max(v for at, v in all_of_them if now - at <= 10)


def test_memory_is_bounded():
    """A robot that pings without end costs no more than some samples."""
    maximum = WindowedMaximum()
    for value in range(10 * MAX_SAMPLES):
        maximum.add(0.0, -value)
    assert len(maximum._samples) == MAX_SAMPLES


@given(
    st.lists(st.tuples(timestamps, st.floats(0, 3)), min_size=1, max_size=20), st.floats(-1e9, 1e9)
)
def test_the_robots_clock_is_never_told_too_late(pings, ahead_s):
    """Whatever the delays of the pings, the result is no later than what the clock really showed."""
    clock = RobotClock()
    for sent_at, delay in sorted(pings):
        clock.on_ping(sent_at + delay, (sent_at + ahead_s) * 1000)
    now = max(sent_at + delay for sent_at, delay in pings)
    told = clock.at(now, now)
    assert told is None or told <= (now + ahead_s) * 1000 + 0.1


def test_the_fastest_ping_counts():
    """One ping without delay is enough for the truth."""
    clock = RobotClock()
    clock.on_ping(1.3, 5000)
    clock.on_ping(2.0, 6000)
    assert clock.at(2.5, 2.25) == pytest.approx(6250)
    assert clock.at(2.5 + WINDOW_S, 2.25) is None
