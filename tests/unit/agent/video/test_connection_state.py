"""What the kernel tells of a TCP connection."""

from __future__ import annotations

import socket
import struct
from contextlib import suppress

import pytest
from openssh_server import wait_until
from robotether_agent.video import pacer
from robotether_agent.video.bandwidth_estimator import Reading
from robotether_agent.video.pacer import read


def look(connection: socket.socket) -> Reading:
    reading = read(connection, 7.0)
    assert reading is not None
    return reading


def test_tells_what_was_written_and_what_arrived(pair: tuple[socket.socket, socket.socket]) -> None:
    """Bytes that the other end's kernel has count as arrived, also unread ones."""
    here, _ = pair
    before = look(here)
    here.sendall(bytes(10_000))
    wait_until(lambda: look(here).in_flight == 0, lambda: "all has arrived")
    after = look(here)
    assert after.written - before.written == 10_000
    assert after.arrived - before.arrived == 10_000
    assert after.at_s == 7.0
    assert 0 < after.min_rtt_s <= after.rtt_s < 1
    assert 500 < after.segment < 70_000


def test_tells_what_has_no_room_at_the_other_end(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    """What waits in our kernel is under way."""
    here, _ = pair
    here.setblocking(False)
    sent = 0
    with suppress(BlockingIOError):
        while True:
            sent += here.send(bytes(65536))
    assert 0 < look(here).in_flight < sent


def test_a_duplicate_tells_the_same(pair: tuple[socket.socket, socket.socket]) -> None:
    """The agent looks at a connection that ssh uses."""
    here, _ = pair
    with here.dup() as duplicate:
        here.sendall(b"x")
        assert look(duplicate).written == look(here).written


def test_nothing_is_told_of_what_is_no_tcp_connection() -> None:
    """A closed socket, one of another kind, and one that never connected."""
    with socket.socket() as unconnected:
        assert read(unconnected, 0.0) is None
    assert read(unconnected, 0.0) is None
    here, there = socket.socketpair()
    with here, there:
        assert read(here, 0.0) is None


def test_a_kernel_that_tells_too_little_tells_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before Linux 4.6 the answer is shorter."""

    class OldKernel(socket.socket):
        def getsockopt(self, level: int, option: int, size: int = 0) -> bytes:  # type: ignore[override]
            return struct.pack("104x")[:size]

    monkeypatch.setattr(pacer.fcntl, "ioctl", lambda *_: bytes(4))
    with OldKernel() as connection:
        assert read(connection, 0.0) is None
