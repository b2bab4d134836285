"""The earliest moment of a client's command, without a network."""

from __future__ import annotations

import struct

from robotether_server.relay.ages import MAX_PINGS_OPEN, ClientMoments


def test_before_the_first_pong_it_is_the_opening():
    """Nothing can have been sent before the connection was there."""
    assert ClientMoments(5.0).of(None, 9.0) == 5.0


def test_a_pong_says_that_what_follows_is_younger_than_its_ping():
    """The newest ping whose pong came counts; older pongs that come late say nothing new."""
    moments = ClientMoments(0.0)
    first, second, third = (moments.ping(float(at)) for at in (1, 2, 3))
    moments.pong(second)
    assert moments.of(None, 4.0) == 2.0
    moments.pong(first)
    assert moments.of(None, 4.0) == 2.0
    moments.pong(third)
    assert moments.of(None, 4.0) == 3.0


def test_a_pong_tells_when_its_ping_was_sent():
    """Once: the round trip is measured by it."""
    moments = ClientMoments(0.0)
    first, second = moments.ping(1.0), moments.ping(2.0)
    assert [moments.pong(payload) for payload in (second, first, second)] == [2.0, None, None]


def test_pongs_that_answer_nothing_say_nothing():
    """Neither another length nor a number that was never sent."""
    moments = ClientMoments(1.0)
    moments.ping(2.0)
    for payload in (b"", b"x", struct.pack("!Q", 99), struct.pack("!Q", 0)):
        assert moments.pong(payload) is None
    assert moments.of(None, 4.0) == 1.0


def test_a_stamp_counts_and_is_never_to_come():
    """A client that says the moment is believed, as far as the moment is over; clocks drift a little."""
    moments = ClientMoments(1.0)
    assert moments.of(2500.0, 4.0) == 2.5
    assert moments.of(4050.0, 4.0) == 4.0


def test_a_stamp_to_come_is_no_moment():
    """Else the commands of a client with a wrong clock would be young however late they come."""
    moments = ClientMoments(1.0)
    assert moments.of(4251.0, 4.0) is None
    assert moments.of(2.0**53, 4.0) is None


def test_open_pings_are_bounded():
    """A client that answers nothing costs no memory; a forgotten ping's pong says nothing."""
    moments = ClientMoments(0.0)
    first = moments.ping(1.0)
    for at in range(2 * MAX_PINGS_OPEN):
        moments.ping(2.0 + at)
    moments.pong(first)
    assert moments.of(None, 999.0) == 0.0
    assert len(moments._open) == MAX_PINGS_OPEN
