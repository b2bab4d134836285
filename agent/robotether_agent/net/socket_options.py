"""What the kernel is told about each TCP connection to the server, and what it tells about one.

An option that this kernel, container or user may not set is left out: a connection without it is slower, not worse.
"""

from __future__ import annotations

import logging
import socket
import struct

# A path that takes nothing for so long is given up, also by a client whose agent is gone.
USER_TIMEOUT_MS = 8000
# What the kernel holds beside what is on its way: more would only be older video when it leaves.
MEDIA_UNSENT_BYTES = 16 * 1024
# Numbers of linux/tcp.h, of which not every Python has the names.
TCP_INFO = 11
TCP_CONGESTION = 13
TCP_USER_TIMEOUT = 18
TCP_NOTSENT_LOWAT = 25
# struct tcp_info begins with bytes: the state, and third the time-outs since the last acknowledgement.
TCP_INFO_START = struct.Struct("=BxB")
ESTABLISHED = 1

log = logging.getLogger(__name__)


def prepare(connection: socket.socket) -> None:
    """Set what holds for every connection, best before it connects."""
    _set(connection, socket.TCP_NODELAY, 1)
    _set(connection, TCP_USER_TIMEOUT, USER_TIMEOUT_MS)


def prepare_for_video(connection: socket.socket) -> None:
    """Keep little unsent, and do not fill the path's queue."""
    _set(connection, TCP_NOTSENT_LOWAT, MEDIA_UNSENT_BYTES)
    _set(connection, TCP_CONGESTION, b"bbr")


def is_stuck(connection: socket.socket) -> bool:
    """Tell whether what was sent waits for an acknowledgement for longer than the path ever took."""
    _, timeouts = _info(connection)
    return timeouts > 0


def is_established(connection: socket.socket) -> bool:
    """Tell whether neither side has ended the connection."""
    state, _ = _info(connection)
    return state == ESTABLISHED


def _info(connection: socket.socket) -> tuple[int, int]:
    try:
        start = connection.getsockopt(socket.IPPROTO_TCP, TCP_INFO, TCP_INFO_START.size)
        state, timeouts = TCP_INFO_START.unpack(start)
    except (OSError, struct.error):
        return 0, 0
    return state, timeouts


def _set(connection: socket.socket, option: int, value: int | bytes) -> None:
    try:
        connection.setsockopt(socket.IPPROTO_TCP, option, value)
    except OSError as error:
        log.debug("TCP option %d is not set: %s", option, error)
