"""Close reasons: short enough for the wire, and readable."""

import pytest
from relay_server import utc
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason, offline_sentence


@pytest.mark.parametrize("letter", ["a", "ä", "日", "🤖"])
def test_a_reason_fits_a_close_frame_and_stays_utf8(letter):
    raw = CloseReason("robot_offline", letter * 200).reason_bytes
    assert 119 < len(raw) <= 123
    assert set(raw.decode()) == {letter}


def test_all_reasons_fit_with_the_longest_name():
    name = "r" * 63
    timestamp = utc(2026, 1, 1, 12, 3)
    for close_reason in (
        close_reasons.client_left(name),
        close_reasons.control_given_up(name),
        close_reasons.rights_ended(name),
        close_reasons.client_silent(name, 6),
        close_reasons.client_slow(name, 10),
        close_reasons.client_floods(name),
        close_reasons.robot_offline(name, timestamp, utc(2026, 2, 1)),
        close_reasons.link_lost(name),
        close_reasons.video_down(name, "the robot refuses the connection"),
        close_reasons.frames_unknown(name),
        close_reasons.frames_broken("a message is over 4 KiB, or no WebSocket"),
        close_reasons.superseded(name),
        close_reasons.relay_stopping(),
        close_reasons.message_too_big(10 * 1024 * 1024, f"robot {name}"),
        close_reasons.message_too_big(64 * 1024, "you"),
        close_reasons.too_many_connections(f"robot {name} already has 64 of them; try again later"),
    ):
        assert len(close_reason.reason.encode()) <= 123, close_reason.name


@pytest.mark.parametrize(
    ("now", "since"),
    [
        (utc(2026, 1, 1, 23, 0), "12:03 UTC"),
        # Yesterday's time alone would be read as today's.
        (utc(2026, 1, 2, 1, 0), "2026-01-01 12:03 UTC"),
    ],
)
def test_offline_since_today_has_the_time_only(now, since):
    sentence = offline_sentence("sim1", utc(2026, 1, 1, 12, 3, 59), now)
    assert sentence == f"robot sim1 has been offline since {since}"
