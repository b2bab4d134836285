"""Reads the kernel's state of a TCP connection: what was sent, what arrived, and how long that takes.

Used by the pacer on the media SSH connection's socket, whose own process is ssh. Only looks; never changes or reads
the connection.
"""

from __future__ import annotations

import fcntl
import socket
import struct
import termios
from dataclasses import dataclass

# linux/tcp.h, struct tcp_info: 8 bytes of flags, 24 numbers of 32 bits, then what came with later kernels.
_MSS = struct.Struct("=16xI")
_RTT = struct.Struct("=68xI")
_BYTES_ACKED = struct.Struct("=120xQ")
# The newest of the fields that are needed here; since Linux 4.6.
_MIN_RTT = struct.Struct("=148xI")
_WANTED = _MIN_RTT.size
_INT = struct.Struct("=i")


@dataclass(frozen=True)
class Reading:
    """One look at a connection; the two counts of bytes are of everything since it was made."""

    at_s: float
    # Bytes that the process wrote, and those of them that the other end has.
    written: int
    arrived: int
    # Smoothed over the last round trips, and the shortest of the last minutes.
    rtt_s: float
    min_rtt_s: float
    segment: int

    @property
    def in_flight(self) -> int:
        """Bytes that wait in the kernel or are in the network."""
        return self.written - self.arrived


def read(connection: socket.socket, now_s: float) -> Reading | None:
    """Look at `connection`; nothing if the kernel does not tell enough, or the connection is gone."""
    try:
        info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _WANTED)
        queued = _INT.unpack(fcntl.ioctl(connection, termios.TIOCOUTQ, bytes(_INT.size)))[0]
    except (OSError, ValueError):
        # ValueError: closed on our side.
        return None
    return None if len(info) < _WANTED else _reading(info, queued, now_s)


def _reading(info: bytes, queued: int, now_s: float) -> Reading | None:
    (arrived,), (rtt_us,), (min_rtt_us,) = (
        field.unpack_from(info) for field in (_BYTES_ACKED, _RTT, _MIN_RTT)
    )
    if not rtt_us or min_rtt_us == 2**32 - 1:
        # Nothing has been measured yet.
        return None
    return Reading(
        at_s=now_s,
        written=arrived + queued,
        arrived=arrived,
        rtt_s=rtt_us / 1e6,
        min_rtt_s=min_rtt_us / 1e6,
        segment=_MSS.unpack_from(info)[0],
    )
