"""Ends a dead connection as soon as the server is reachable again, without waiting for a time-out.

A task of each connection. It never ends a connection by which somebody drives and that works: silence counts only
while the kernel, too, waits for the other side, and mostly a fresh connection must get an answer first, which the next
dial then uses. So a server that is merely slow is not stormed by its robots.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from ipaddress import IPv6Interface
from typing import NoReturn

from robotether_agent.clock import robot_time
from robotether_agent.net import netlink
from robotether_agent.net.server_dialer import SETTLED_AFTER_S, ServerDialer, SshAddress
from robotether_agent.net.tcp import is_stuck
from robotether_agent.problems import (
    AgentError,
    LinkError,
    NetworkChangedError,
    Retry,
    ServerSilentError,
)
from robotether_agent.tasks import first_of
from robotether_agent.tunnel.session import Session
from robotether_agent.tunnel.tunnel import Tunnel

# Time without data before a connection counts as silent, two heartbeats and a margin; an idle robot
# adds `idle_delay_s`.
SILENT_AFTER_S = 1.2
# Time of silence after which a new connection is drivable earlier than the old one.
HOPELESS_AFTER_S = 4.0
CHECK_EVERY_S = 0.2
# Minimum delay of a poll that shows that this process or the whole machine was suspended.
PAUSED_S = 1.5
# Time after a suspension in which the connection is distrusted.
DISTRUST_S = 3.0
# Time of silence that is enough then, and on a path that moved while somebody drives.
DISTRUSTED_AFTER_S = 0.6
# Pause after a failed attempt on another connection: a new network without a route to the server
# must not be tried all the time while the old one works.
REST_S = 10.0

log = logging.getLogger(__name__)


class Path(Enum):
    """What became of a connection's way out."""

    SAME = "same"
    # A new connection would leave from another address: another network, or another card.
    MOVED = "moved"
    # Its own address is no longer this machine's: nothing can come back to it.
    GONE = "gone"


def path_of(connection: socket.socket) -> Path:
    """Return what became of the path of a connection that is or was up."""
    try:
        here, there = connection.getsockname(), connection.getpeername()
        if not _is_ours(connection.family, here):
            return Path.GONE
        now = _source_towards(connection.family, there)
    except OSError:
        # It ended by itself, which shows elsewhere, or there is no file descriptor to ask with.
        return Path.SAME
    return Path.SAME if now in {None, here[0]} or _is_renewed(here[0], now) else Path.MOVED


def _is_ours(family: int, address: tuple[object, ...]) -> bool:
    host, _, *rest = address
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((host, 0, *rest))
        except OSError as error:
            return error.errno != errno.EADDRNOTAVAIL
    return True


def _is_renewed(here: object, now: object) -> bool:
    """Whether both are of one IPv6 network, which renews addresses each day (RFC 8981) while the old ones last."""
    try:
        return IPv6Interface(f"{here}/64").network == IPv6Interface(f"{now}/64").network
    except ValueError:
        return False


def _source_towards(family: int, address: tuple[object, ...]) -> object:
    """Return the address that a new connection would come from, None without a route."""
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(address)
        except OSError:
            return None
        return probe.getsockname()[0]


async def watch(
    session: Session,
    tunnel: Tunnel,
    target: SshAddress,
    elsewhere: Callable[[], Sequence[SshAddress]],
    is_driven: Callable[[], bool],
) -> NoReturn:
    """Raise ServerSilentError or NetworkChangedError when the connection is dead; else never end.

    `elsewhere` returns the addresses of the other cells, as they are known by then.
    """
    watched = _Watch(session, tunnel, target, elsewhere, is_driven)
    with netlink.listening() as network:
        await first_of(watched.keep_checking(), watched.watch_network(network))
    raise AssertionError("a watch of a connection ended without a problem")


@dataclass(frozen=True)
class Signs:
    """How a connection is at one time."""

    path: Path
    silent_s: float
    # What was sent is not acknowledged. Unknown behind a proxy, which acknowledges in the server's place.
    is_stuck: bool
    # This machine has just slept.
    is_distrusted: bool = False
    idle_delay_s: float = 0.0
    is_driven: bool = False

    @property
    def is_silent(self) -> bool:
        """Whether what should have come has not."""
        is_doubtful = self.is_distrusted or (self.is_driven and self.path is Path.MOVED)
        limit_s = DISTRUSTED_AFTER_S if is_doubtful else SILENT_AFTER_S
        return self.silent_s >= limit_s + self.idle_delay_s


def suspicion(signs: Signs) -> LinkError | None:
    """Return why the connection may be dead, as the problem that it then is."""
    if signs.path is Path.GONE:
        return NetworkChangedError("lost the connection: its address is no longer this robot's")
    if signs.is_stuck and signs.is_silent:
        why = f"the server was silent for {signs.silent_s:.1f} s"
        return ServerSilentError(f"lost the connection: {why}", retry=Retry.AT_ONCE)
    if signs.path is Path.MOVED and not signs.is_driven:
        return NetworkChangedError(
            "left the connection: this robot's route now leads through another network"
        )
    return None


def is_certain(signs: Signs) -> bool:
    """Return whether a suspicion needs no answer on another connection."""
    hopeless = signs.is_stuck and signs.silent_s >= HOPELESS_AFTER_S
    return signs.path is Path.GONE or hopeless


class _Watch:
    """One connection, and at most one attempt to reach its server on another."""

    def __init__(
        self,
        session: Session,
        tunnel: Tunnel,
        target: SshAddress,
        elsewhere: Callable[[], Sequence[SshAddress]],
        is_driven: Callable[[], bool],
    ) -> None:
        self._session = session
        self._tunnel = tunnel
        self._target = target
        self._elsewhere = elsewhere
        self._is_driven = is_driven
        self._dialer = target.dialer or ServerDialer()
        self._checked_at = robot_time()
        self._wake = asyncio.Event()
        self._has_changed = False
        self._distrusted_until = 0.0
        self._rest_until = 0.0

    async def watch_network(self, network: netlink.Network) -> NoReturn:
        """Poll at once whenever the network has changed."""
        while True:
            await network.changed()
            await asyncio.sleep(SETTLED_AFTER_S)
            self._has_changed = True
            self._wake.set()

    async def keep_checking(self) -> NoReturn:
        """Look again and again; raise why the connection is dead, once it is."""
        while True:
            await self._until_next_check()
            problem = suspicion(signs := self._signs())
            if problem is None:
                continue
            if is_certain(signs) or await self._is_answered_elsewhere(problem):
                raise problem

    async def _until_next_check(self) -> None:
        # A timer, as a task for each wait costs a robot that only waits a good part of its time.
        timer = asyncio.get_running_loop().call_later(CHECK_EVERY_S, self._wake.set)
        try:
            await self._wake.wait()
        finally:
            timer.cancel()
        self._wake.clear()
        if self._has_changed:
            self._has_changed = False
            self._rest_until = 0.0
        uptime_s = self._since_last_check_s() - CHECK_EVERY_S
        if uptime_s > PAUSED_S:
            log.info("this process was frozen for %.1f s: checking the server", uptime_s)
            self._distrusted_until = time.monotonic() + DISTRUST_S

    def _since_last_check_s(self) -> float:
        """Return the seconds since the last call, the machine's sleep included."""
        before, self._checked_at = self._checked_at, robot_time()
        return self._checked_at - before

    def _signs(self) -> Signs:
        connection = self._tunnel.socket
        return Signs(
            path_of(connection),
            self._session.silent_s,
            is_stuck=self._dialer.is_proxied or is_stuck(connection),
            is_distrusted=time.monotonic() < self._distrusted_until,
            idle_delay_s=self._session.idle_delay_s,
            is_driven=self._is_driven(),
        )

    async def _is_answered_elsewhere(self, problem: LinkError) -> bool:
        """Try to reach the server; return True if it answers there while this connection still looks dead.

        Another cell counts when this one is silent; when only the network has changed it is no reason to leave it.
        """
        if time.monotonic() < self._rest_until:
            return False
        others = self._elsewhere() if isinstance(problem, ServerSilentError) else ()
        unreached_s = self._session.silent_s - self._session.idle_delay_s
        target: SshAddress | None = None
        try:
            target = await first_of(
                self._dialer.find([self._target, *others], unreached_s=unreached_s),
                self._until_clear(),
            )
        except AgentError as why:
            log.debug("the server does not answer on another connection: %s", why)
            self._rest_until = time.monotonic() + REST_S
        if replace(self._signs(), is_distrusted=True).is_silent:
            self._rest_until = 0.0
        self._since_last_check_s()
        return target is not None and suspicion(self._signs()) is not None

    async def _until_clear(self) -> None:
        """Wait until there is no suspicion any more, or certainty."""
        while True:
            await asyncio.sleep(CHECK_EVERY_S)
            signs = self._signs()
            if suspicion(signs) is None or is_certain(signs):
                return
