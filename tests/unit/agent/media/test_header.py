"""The sixteen bytes before each picture."""

from __future__ import annotations

import pytest
from robotether_agent.media.header import SIZE, Header, unpacked


def test_the_bytes_are_as_documented():
    """Codec, flags, quality, number and moment, big-endian."""
    header = Header(number=7, moment_ms=1.5, quality=70, is_stamped=True)
    assert header.packed() == bytes.fromhex("01 01 0046 00000007 3ff8000000000000")
    assert len(header.packed()) == SIZE


def test_a_header_is_read_back_with_a_picture_behind_it():
    """What was packed."""
    header = Header(number=2**32 - 1, moment_ms=5123456.7, quality=0)
    assert unpacked(header.packed() + b"\xff\xd8") == header


def test_the_number_starts_again():
    """Modulo 2^32."""
    assert unpacked(Header(number=2**32 + 3, moment_ms=0).packed()).number == 3


def test_too_short_a_message_is_refused():
    """Not read as something else."""
    with pytest.raises(ValueError, match="at least 16 bytes"):
        unpacked(bytes(15))
