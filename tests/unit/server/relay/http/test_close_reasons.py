"""Close reasons: short enough for the wire, and readable."""

import pytest
from relay_server import utc
from robotether_server.relay.http.close_reasons import CloseReason, offline_sentence


@pytest.mark.parametrize("letter", ["a", "ä", "日", "🤖"])
def test_a_reason_fits_a_close_frame_and_stays_utf8(letter):
    raw = CloseReason("robot_offline", letter * 200).reason_bytes
    assert 119 < len(raw) <= 123
    assert set(raw.decode()) == {letter}


def test_offline_since_yesterday_has_the_day():
    """Yesterday's time alone would be read as today's."""
    sentence = offline_sentence("sim1", utc(2026, 1, 1, 12, 3, 59), utc(2026, 1, 2, 1, 0))
    assert sentence == "robot sim1 has been offline since 2026-01-01 12:03 UTC"
