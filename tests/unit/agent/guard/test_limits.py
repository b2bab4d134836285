"""Speed, turn, steering, and how fast they grow."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st
from robotether_agent.guard.commands import Command, Vector
from robotether_agent.guard.limits import MAX_STEP_S, Limits, limited

SLACK = 1 + 1e-9

number = st.floats(-1e6, 1e6)
vector = st.tuples(number, number, number)
# Of a subnormal number the last digits are lost, far below any speed.
limit = st.none() | st.floats(0, 100, allow_subnormal=False)
limits = st.builds(Limits, limit, limit, limit, limit, limit)
commands = st.builds(Command, st.just("twist"), vector, vector, number)
step = st.floats(-1, 1e4)


def length(values: Vector) -> float:
    return math.hypot(*values)


def driven(speed: float) -> Command:
    return Command("twist", (speed, 0.0, 0.0))


@given(commands, st.none() | commands, step, limits)
def test_no_command_exceeds_a_limit(
    wanted: Command, before: Command | None, step_s: float, within: Limits
) -> None:
    """Whatever came before and whenever that was."""
    got = limited(wanted, before, step_s, within)
    if within.max_speed_m_s is not None:
        assert length(got.linear) <= within.max_speed_m_s * SLACK
    if within.max_turn_rad_s is not None:
        assert length(got.angular) <= within.max_turn_rad_s * SLACK
    if within.max_steering_rad is not None:
        assert abs(got.steering) <= within.max_steering_rad
    if within.max_acceleration_m_s2 is not None:
        had = length(before.linear) if before else 0.0
        assert (
            length(got.linear) <= (had + within.max_acceleration_m_s2 * MAX_STEP_S) * SLACK + 1e-9
        )


@given(commands, st.none() | commands, step, limits)
def test_a_command_only_becomes_slower_and_keeps_its_direction(
    wanted: Command, before: Command | None, step_s: float, within: Limits
) -> None:
    """A limit never turns, speeds up or reverses a robot."""
    got = limited(wanted, before, step_s, within)
    for asked, given_ in zip(
        (*wanted.linear, *wanted.angular), (*got.linear, *got.angular), strict=True
    ):
        assert abs(given_) <= abs(asked) * SLACK
        assert asked * given_ >= 0


@given(vector, st.floats(0, 1), step, limits)
def test_braking_is_never_delayed(
    before: Vector, part: float, step_s: float, within: Limits
) -> None:
    """Less of the same motion passes as it is, if the robot was within its speed."""
    x, y, z = before
    wanted = Command("twist", (x * part, y * part, z * part), (x * part, y * part, z * part))
    growth = Limits(
        None, None, within.max_acceleration_m_s2, within.max_turn_acceleration_rad_s2, None
    )
    got = limited(wanted, Command("twist", before, before), step_s, growth)
    assert math.dist(got.linear, wanted.linear) <= length(wanted.linear) * 1e-9
    assert math.dist(got.angular, wanted.angular) <= length(wanted.angular) * 1e-9


@given(commands, step, limits)
def test_a_stop_is_a_stop(before: Command, step_s: float, within: Limits) -> None:
    assert not limited(Command("twist"), before, step_s, within).moves


def test_speed_grows_by_the_acceleration() -> None:
    """From 1 m/s with 2 m/s2, 50 ms later: 1.1 m/s."""
    got = limited(driven(5), driven(1), 0.05, Limits(max_acceleration_m_s2=2))
    assert math.isclose(got.linear[0], 1.1)


def test_a_pause_is_not_made_up_for() -> None:
    """After ten seconds a robot that stood begins as slowly as always."""
    got = limited(driven(5), None, 10, Limits(max_acceleration_m_s2=2))
    assert math.isclose(got.linear[0], 2 * MAX_STEP_S)


def test_the_other_way_begins_at_a_standstill() -> None:
    """Full reverse brakes at once and then grows as from zero."""
    got = limited(driven(-5), driven(5), 0.05, Limits(max_acceleration_m_s2=2))
    assert math.isclose(got.linear[0], -0.1)


def test_speed_is_the_vectors_length() -> None:
    """3 and 4 m/s are 5, limited to 1 they are 0.6 and 0.8."""
    got = limited(Command("twist", (3.0, 4.0, 0.0)), None, 0, Limits(max_speed_m_s=1))
    assert math.dist(got.linear, (0.6, 0.8, 0.0)) < 1e-12
