"""The sixteen bytes before each frame."""

from __future__ import annotations

from robotether_agent.video.frame_header import SIZE, Header


def test_the_bytes_are_as_documented():
    """Codec, flags, quality, number and moment, big-endian."""
    header = Header(sequence=7, timestamp_ms=1.5, quality=70, is_stamped=True)
    assert header.packed() == bytes.fromhex("01 01 0046 00000007 3ff8000000000000")
    assert len(header.packed()) == SIZE
