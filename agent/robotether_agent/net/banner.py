"""Finds out whether an SSH server is at the other end of a connection, and not merely something that accepts.

Used by the way, for a proxy, a NAT or a captive portal may accept in the server's place. Where the server speaks first
nothing is used up by that. Behind nginx, which waits for the client's first words, the connection is spent.
"""

from __future__ import annotations

import asyncio
import socket

from robotether_agent.fields import printable
from robotether_agent.net.tcp import CHECK_NETWORK, peek
from robotether_agent.problems import NoAnswer, Problem, ServerBusy, ServerUnreachable
from robotether_agent.tasks import within

SSH = b"SSH-"
# What sshd says in place of its banner when it lets no further log-in begin: OpenSSH 10, and those before it.
FULL = (b"Not allowed at this time", b"Exceeded MaxStartups")
CLIENT_BANNER = b"SSH-2.0-robotether\r\n"
# A server that speaks first does so one round trip after the connection stands, unless it has much to do. To be spoken
# to by mistake costs it a second connection, so this is long; ports that are known to wait are spoken to at once.
SPEAK_AFTER_S = 6.0
# As long as sshd lets a login take.
TIMEOUT_S = 15.0
HTTPS = 443


class Banner:
    """Which of the server's ports speak only when spoken to."""

    def __init__(self, https_port: int = HTTPS) -> None:
        # Where the site is, nginx is in front of sshd.
        self._silent_ports = {HTTPS, https_port}

    async def check(self, connection: socket.socket, port: int, name: str) -> bool:
        """Return whether the connection is unused still; raise a problem if no SSH server is there."""
        try:
            if port not in self._silent_ports and await _receives_ssh(
                connection, SPEAK_AFTER_S, name
            ):
                return True
            connection.send(CLIENT_BANNER)
            if not await _receives_ssh(connection, TIMEOUT_S, name):
                why = "it accepts the connection and says nothing"
                raise NoAnswer(f"cannot reach SSH at {name}: {why}", advice=CHECK_NETWORK)
        except OSError as error:
            raise _closed(name) from error
        self._silent_ports.add(port)
        return False


async def _receives_ssh(connection: socket.socket, timeout_s: float, name: str) -> bool:
    try:
        words = await within(timeout_s, peek(connection, _is_long_enough, 64))
    except asyncio.TimeoutError:
        return False
    if not words.startswith(SSH):
        raise _no_ssh(name, words)
    return True


def _is_long_enough(words: bytes) -> bool:
    return len(words) >= len(SSH)


def _closed(name: str) -> Problem:
    return ServerUnreachable(
        f"cannot reach SSH at {name}: it closes the connection without a word",
        advice="see that the server is up and not overloaded; this is tried again",
    )


def _no_ssh(name: str, words: bytes) -> Problem:
    if words.startswith(FULL):
        return ServerBusy(
            f"cannot log in at {name} now: as many log-ins are under way there as it takes at once"
        )
    said = printable(words.decode("ascii", errors="replace").split("\r\n")[0], 60)
    return ServerUnreachable(
        f"cannot reach SSH at {name}: what answers there is no SSH server ({said!r})",
        advice="find out what is in between, such as a captive portal, and log in to it",
    )
