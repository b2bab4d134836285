"""The earliest moment of a client's command, without a network."""

from __future__ import annotations

import struct

from robotether_server.relay.rosbridge.command_age import MAX_PINGS_OPEN, CommandTimestamps


def test_before_the_first_pong_it_is_the_opening():
    """Nothing can have been sent before the connection was there."""
    assert CommandTimestamps(5.0).of(None, 9.0) == 5.0


def test_a_pong_says_that_what_follows_is_younger_than_its_ping():
    """The newest ping whose pong came counts; older pongs that come late say nothing new."""
    timestamps = CommandTimestamps(0.0)
    first, second, third = (timestamps.ping(float(at)) for at in (1, 2, 3))
    timestamps.pong(second)
    assert timestamps.of(None, 4.0) == 2.0
    timestamps.pong(first)
    assert timestamps.of(None, 4.0) == 2.0
    timestamps.pong(third)
    assert timestamps.of(None, 4.0) == 3.0


def test_a_pong_tells_when_its_ping_was_sent():
    """Once: the round trip is measured by it."""
    timestamps = CommandTimestamps(0.0)
    first, second = timestamps.ping(1.0), timestamps.ping(2.0)
    assert [timestamps.pong(payload) for payload in (second, first, second)] == [2.0, None, None]


def test_pongs_that_answer_nothing_say_nothing():
    """Neither another length nor a number that was never sent."""
    timestamps = CommandTimestamps(1.0)
    timestamps.ping(2.0)
    for payload in (b"", b"x", struct.pack("!Q", 99), struct.pack("!Q", 0)):
        assert timestamps.pong(payload) is None
    assert timestamps.of(None, 4.0) == 1.0


def test_a_stamp_counts_and_is_never_to_come():
    """A client that says the moment is believed, as far as the moment is over; clocks drift a little."""
    timestamps = CommandTimestamps(1.0)
    assert timestamps.of(2500.0, 4.0) == 2.5
    assert timestamps.of(4050.0, 4.0) == 4.0


def test_a_stamp_to_come_is_no_timestamp():
    """Else the commands of a client with a wrong clock would be young however late they come."""
    timestamps = CommandTimestamps(1.0)
    assert timestamps.of(4251.0, 4.0) is None
    assert timestamps.of(2.0**53, 4.0) is None


def test_open_pings_are_bounded():
    """A client that answers nothing costs no memory; a forgotten ping's pong says nothing."""
    timestamps = CommandTimestamps(0.0)
    first = timestamps.ping(1.0)
    for at in range(2 * MAX_PINGS_OPEN):
        timestamps.ping(2.0 + at)
    timestamps.pong(first)
    assert timestamps.of(None, 999.0) == 0.0
    assert len(timestamps._open) == MAX_PINGS_OPEN
