"""The parts of multipart streams, as servers and cameras write them."""

from __future__ import annotations

import pytest
from robotether_agent.video import multipart
from robotether_agent.video.multipart import (
    MultipartBrokenError,
    MultipartParser,
    Part,
    boundary_of,
)

BODIES = [b"\xff\xd8one\r\n\xff\xd9", b"\xff\xd8two\n\n\xff\xd9"]
SERVER = b"--b\r\n" + b"".join(
    b"Content-type: image/jpeg\r\nX-Timestamp: 12.500000\r\nContent-Length: %d\r\n\r\n%s\r\n--b\r\n"
    % (len(body), body)
    for body in BODIES
)
NO_LENGTH = (
    b"".join(b"\r\n--b\r\nContent-Type: image/jpeg\r\n\r\n" + body for body in BODIES)
    + b"\r\n--b\r\n"
)
BARE_LF = b"".join(b"\n--b\nContent-Length: %d\n\n%s" % (len(body), body) for body in BODIES)


def in_pieces(stream: bytes, length: int) -> list[Part]:
    parts = MultipartParser(b"--b")
    pieces = (stream[at : at + length] for at in range(0, len(stream), length))
    return [part for piece in pieces for part in parts.feed(piece)]


@pytest.mark.parametrize("stream", [SERVER, NO_LENGTH, BARE_LF])
@pytest.mark.parametrize("length", [1, 7, 10_000])
def test_the_parts_of_a_stream(stream, length):
    assert [part.body for part in in_pieces(stream, length)] == BODIES


@pytest.mark.parametrize(
    "content_type",
    [
        "multipart/x-mixed-replace;boundary=b",
        'multipart/x-mixed-replace; boundary="--b"',
        "multipart/x-mixed-replace; boundary=--b",
    ],
)
def test_the_boundary_as_cameras_name_it(content_type):
    assert boundary_of(content_type) == b"--b"


def test_nothing_grows_without_bound(monkeypatch):
    monkeypatch.setattr(multipart, "MAX_FRAME_BYTES", 1000)
    for stream in (
        b"--b\r\nContent-Length: 1001\r\n\r\n",
        b"--b\r\nA: b\r\n\r\n" + bytes(2000),
        b"--b\r\n" + b"A: b\r\n" * 2000,
        b"\r\n" * 10_000,
    ):
        with pytest.raises(MultipartBrokenError):
            in_pieces(stream, 100)
