"""When a connection is silent or slow, without a network."""

from __future__ import annotations

from robotether_server.relay.http.liveness import DRIVER_LIMITS, Liveness, LivenessLimits

LIMITS = LivenessLimits()


def verdicts(looks: list[tuple[float, float, tuple[int, int], tuple[int, int]]]) -> list[str]:
    """Judge (now, heard at, to client, to robot) one after the other."""
    liveness = Liveness(LIMITS, 0.0)
    return [
        liveness.check(now, received_at=received_at, to_client=to_client, to_robot=to_robot)
        for now, received_at, to_client, to_robot in looks
    ]


def test_who_is_heard_is_alive():
    """As long as something comes, nothing is wrong."""
    assert verdicts([(t, t - 1, (0, 0), (0, 0)) for t in (2.0, 20.0, 200.0)]) == ["ok"] * 3


def test_silence_counts_from_the_last_sign():
    """More than 6 s without message and pong is silent, not less."""
    assert verdicts([(5.9, 0.0, (0, 0), (0, 0)), (6.1, 0.0, (0, 0), (0, 0))]) == [
        "ok",
        "client_silent",
    ]


def test_a_full_buffer_that_does_not_move_is_slow():
    """More than 10 s with the same bytes waiting is slow, although nothing was heard for longer."""
    stuck = (1_000_000, 70_000)
    looks = [(t / 2, 0.0, stuck, (0, 0)) for t in range(1, 22)]
    assert verdicts([*looks, (11.0, 0.0, stuck, (0, 0))])[-2:] == ["ok", "client_slow"]


def test_a_buffer_that_moves_is_neither_slow_nor_silent():
    """One large message over a slow line may take longer than both limits."""
    looks = [(t, 0.0, (10_000_000, 10_000_000 - t * 100_000), (0, 0)) for t in range(1, 60)]
    assert set(verdicts(looks)) == {"ok"}


def test_after_a_full_buffer_silence_counts_anew():
    """A ping behind data arrives late, so its pong may be as late."""
    looks = [
        (1.0, 0.0, (1000, 100), (0, 0)),
        (6.5, 0.0, (1000, 50), (0, 0)),
        (7.0, 0.0, (1000, 0), (0, 0)),
        (12.4, 0.0, (1000, 0), (0, 0)),
        (12.6, 0.0, (1000, 0), (0, 0)),
    ]
    assert verdicts(looks) == ["ok", "ok", "ok", "ok", "client_silent"]


def test_a_robot_that_takes_nothing_is_the_slow_one():
    """While the robot's side is full the client is not read, and not called silent."""
    full = (5_000_000, 70_000)
    looks = [(float(t), 0.0, (0, 0), full) for t in range(1, 13)]
    assert verdicts(looks)[9] == "ok"
    assert verdicts(looks)[-1] == "robot_slow"


def test_a_driver_is_silent_whatever_waits_for_it():
    """Data on its way to a driver is no sign of it; a full robot's side is, for it is not read then."""
    liveness = Liveness(DRIVER_LIMITS, 0.0)
    moving = [(t / 10, (10_000_000, 9_000_000 - t)) for t in range(1, 27)]
    found = [
        liveness.check(now, received_at=0.0, to_client=waiting, to_robot=(0, 0))
        for now, waiting in moving
    ]
    assert (found[24], found[25]) == ("ok", "client_silent")
    liveness = Liveness(DRIVER_LIMITS, 0.0)
    full = [
        liveness.check(t / 10, received_at=0.0, to_client=(0, 0), to_robot=(9000, 9000 - t))
        for t in range(1, 40)
    ]
    assert set(full) == {"ok"}
