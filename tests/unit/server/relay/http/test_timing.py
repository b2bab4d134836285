"""Rates, silence, clocks and pauses, without a network and with moments of the test's own."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_server.relay.http.timing import (
    DRIVER_LIMITS,
    MAX_SAMPLES,
    WINDOW_S,
    Liveness,
    LivenessLimits,
    RateLimiter,
    RobotClock,
    WindowedMaximum,
)

timestamps = st.floats(0, 1e6)


def taken(limiter, now, tries):
    return sum(limiter.allow(now) for _ in range(tries))


def test_a_limiter_fills_again_with_time_and_says_when():
    limiter = RateLimiter(0.0, per_s=0.5, at_once=2)
    assert limiter.free_in_s(0.0) == 0
    assert taken(limiter, 0.0, 100) == 2
    assert limiter.free_in_s(0.0) == 2
    assert limiter.free_in_s(1.5) == 0.5
    assert not limiter.allow(1.5)
    assert limiter.allow(2.0)
    assert taken(limiter, 60.0, 100) == 2


def verdicts(looks, limits=None):
    """Judge (now, heard at, to client, to robot) one after the other."""
    liveness = Liveness(limits or LivenessLimits(), 0.0)
    return [
        liveness.check(now, received_at=received_at, to_client=to_client, to_robot=to_robot)
        for now, received_at, to_client, to_robot in looks
    ]


NOTHING, STUCK = (0, 0), (1_000_000, 70_000)


@pytest.mark.parametrize(
    ("looks", "last"),
    [
        ([(t / 2, 0.4, NOTHING, NOTHING) for t in range(1, 14)], ["ok", "client_silent"]),
        # The same bytes wait for more than 10 s, although nothing was heard for longer.
        ([(t / 2, 0.0, STUCK, NOTHING) for t in range(1, 23)], ["ok", "client_slow"]),
        # While the robot's side is full the client is not read, and not called silent.
        ([(float(t), 0.0, NOTHING, STUCK) for t in range(1, 13)], ["ok", "robot_slow"]),
    ],
)
def test_silence_and_slowness_count_from_the_last_sign(looks, last):
    assert verdicts(looks)[-2:] == last


def test_a_look_that_comes_late_judges_nobody():
    """What came while the relay stood still is not read yet; without a sign, the next looks judge as ever."""
    late = [(0.5, 0.0, (9000, 70), (9000, 70)), (60.0, 0.0, (9000, 70), (9000, 70))]
    nothing = (9000, 0), (9000, 0)
    assert verdicts(late) == ["ok", "ok"]
    after = [(60 + t / 2, 0.0, *nothing) for t in range(14)]
    assert verdicts([*late, *after])[-2:] == ["ok", "client_silent"]


def test_a_buffer_that_moves_is_neither_slow_nor_silent():
    """One large message over a slow line may take longer than both limits."""
    looks = [(t, 0.0, (10_000_000, 10_000_000 - t * 100_000), (0, 0)) for t in range(1, 60)]
    assert set(verdicts(looks)) == {"ok"}


def test_after_a_full_buffer_silence_counts_anew():
    """A ping behind data arrives late, so its pong may be as late."""
    looks = [
        *((t / 2, 0.0, (1000, 100), (0, 0)) for t in range(1, 13)),
        (6.5, 0.0, (1000, 50), (0, 0)),
        *((t / 2, 0.0, (1000, 0), (0, 0)) for t in range(14, 27)),
    ]
    assert verdicts(looks)[-2:] == ["ok", "client_silent"]


def test_a_driver_is_silent_whatever_waits_for_it():
    """Data on its way to a driver is no sign of it; a full robot's side is, for it is not read then."""
    moving = [(t / 10, 0.0, (10_000_000, 9_000_000 - t), (0, 0)) for t in range(1, 27)]
    assert verdicts(moving, DRIVER_LIMITS)[-2:] == ["ok", "client_silent"]
    full = [(t / 10, 0.0, (0, 0), (9000, 9000 - t)) for t in range(1, 40)]
    assert set(verdicts(full, DRIVER_LIMITS)) == {"ok"}


def test_memory_of_the_window_is_bounded():
    maximum = WindowedMaximum()
    for value in range(10 * MAX_SAMPLES):
        maximum.add(0.0, -value)
    assert len(maximum._samples) == MAX_SAMPLES


@given(
    st.lists(st.tuples(timestamps, st.floats(0, 3)), min_size=1, max_size=20), st.floats(-1e9, 1e9)
)
def test_the_robots_clock_is_never_told_too_late(pings, ahead_s):
    clock = RobotClock()
    for sent_at, delay in sorted(pings):
        clock.on_ping(sent_at + delay, (sent_at + ahead_s) * 1000)
    now = max(sent_at + delay for sent_at, delay in pings)
    timestamp = clock.at(now, now)
    assert timestamp is None or timestamp <= (now + ahead_s) * 1000 + 0.1


def test_the_fastest_ping_counts():
    """One ping without delay is enough for the truth."""
    clock = RobotClock()
    clock.on_ping(1.3, 5000)
    clock.on_ping(2.0, 6000)
    assert clock.at(2.5, 2.25) == pytest.approx(6250)
    assert clock.at(2.5 + WINDOW_S, 2.25) is None
