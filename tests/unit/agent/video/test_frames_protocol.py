"""The texts and the header of the frames protocol."""

from __future__ import annotations

import pytest
from robotether_agent.fields import FieldError
from robotether_agent.video.receiver import (
    ClockSync,
    Credit,
    Header,
    parse,
)
from robotether_common.frames import HEADER, StreamRequest


def test_the_bytes_are_as_documented():
    """Codec, flags, quality, number and moment, big-endian."""
    header = Header(sequence=7, timestamp_ms=1.5, quality=70, is_stamped=True)
    assert header.packed() == bytes.fromhex("01 01 0046 00000007 3ff8000000000000")
    assert len(header.packed()) == HEADER.size


def test_each_request_with_its_defaults():
    """Nothing but `op` has to be there; what is not known is skipped."""
    assert parse('{"op": "want"}') == StreamRequest(20, 80, 15, 300, None, None)
    assert parse(
        '{"op": "want", "fps": 0.5, "width": 320, "height": 240, "new": 1}'
    ) == StreamRequest(fps=0.5, width=320, height=240)
    assert parse('{"op": "credit"}') == Credit(1, None)
    assert parse('{"op": "credit", "frames": 99, "taken": 41}') == Credit(2, 41)
    assert parse('{"op": "beat", "t_ms": 81.2}') == ClockSync(81.2)
    assert parse('{"op": "of a newer side"}') is None


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[]", "JSON object"),
        ("{", "not JSON"),
        ("{}", "op"),
        ('{"op": "beat"}', "t_ms"),
        ('{"op": "beat", "t_ms": NaN}', "t_ms"),
        ('{"op": "want", "quality_min": 0}', "quality_min"),
        ('{"op": "want", "quality_min": 81}', "quality_min"),
        ('{"op": "want", "fps": 61}', "fps"),
        ('{"op": "want", "latency_ms": "fast"}', "latency_ms"),
        ('{"op": "want", "width": 640}', "width and height"),
        ('{"op": "want", "width": 4097, "height": 1}', "width"),
        ('{"op": "credit", "taken": -1}', "taken"),
        ('{"op": "credit", "frames": true}', "frames"),
    ],
)
def test_what_is_broken_is_named(text, named):
    """The field, so that the other side's log tells."""
    with pytest.raises(FieldError, match=named):
        parse(text)
