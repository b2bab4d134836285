"""Close reasons: short enough for the wire, and readable."""

from __future__ import annotations

import pytest
from relay_server import utc
from robotether_server.relay import endings
from robotether_server.relay.endings import Ending, offline_sentence


@pytest.mark.parametrize("letter", ["a", "ä", "日", "🤖"])
def test_a_reason_fits_a_close_frame_and_stays_utf8(letter):
    """A long reason is cut to 123 bytes, between characters."""
    raw = Ending(4503, "x", letter * 200).reason_bytes
    assert 119 < len(raw) <= 123
    assert set(raw.decode()) == {letter}


def test_all_reasons_fit_with_the_longest_name():
    """With a name of 63 letters, the longest that the database has, every reason is whole."""
    name = "r" * 63
    moment = utc(2026, 1, 1, 12, 3)
    for ending in (
        endings.client_left(name),
        endings.rights_ended(name),
        endings.client_silent(name, 6),
        endings.client_slow(name, 10),
        endings.client_floods(name),
        endings.robot_offline(name, moment, utc(2026, 2, 1)),
        endings.link_lost(name),
        endings.video_down(name, "the robot refuses the connection"),
        endings.frames_unknown(name),
        endings.frames_broken("a message is over 4 KiB, or no WebSocket"),
        endings.superseded(name),
        endings.relay_stopping(),
        endings.message_too_big(10 * 1024 * 1024, f"robot {name}"),
        endings.message_too_big(64 * 1024, "you"),
        endings.too_many_connections(f"robot {name} has 64 of them already; try again later"),
    ):
        assert len(ending.reason.encode()) <= 123, ending.name


def test_offline_since_today_has_the_time_only():
    """The sentence of the contract."""
    since, now = utc(2026, 1, 1, 12, 3, 59), utc(2026, 1, 1, 23, 0)
    assert offline_sentence("sim1", since, now) == "robot sim1 is offline since 12:03 UTC"


def test_offline_since_another_day_has_the_day():
    """Yesterday's time alone would be read as today's."""
    since, now = utc(2026, 1, 1, 12, 3), utc(2026, 1, 2, 1, 0)
    expected = "robot sim1 is offline since 2026-01-01 12:03 UTC"
    assert offline_sentence("sim1", since, now) == expected


def test_who_has_the_control_is_named():
    """The sentences of the contract."""
    moment = utc(2026, 1, 1, 12, 3, 59)
    assert [
        (ending.code, ending.reason)
        for ending in (
            endings.robot_stopped("sim1", "ben", moment),
            endings.lease_held("sim1", "ann", moment),
            endings.lease_held("sim1", "ann", None),
            endings.lease_lost("sim1", "ben"),
        )
    ] == [
        (4003, "ben stopped sim1 at 12:03 UTC; a driver must release it"),
        (4009, "ann drives sim1 since 12:03 UTC; ask for the control, or wait"),
        (4009, "the control of sim1 is kept for ann; wait a moment"),
        (4010, "the control of sim1 is ben's now"),
    ]
