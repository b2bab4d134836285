"""Connects to the server by whichever cell, port, address and proxy works now.

One for all connections of an agent, and for their liveness. It keeps at most one connection in hand, which was tried
and not used yet, and none for longer than a few seconds. It never speaks SSH itself beyond a first line.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import weakref
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, groupby, repeat
from random import Random
from time import monotonic

from robotether_agent.describe_error import SILENT_ADVICE
from robotether_agent.fields import ListedCell, printable
from robotether_agent.net import netlink
from robotether_agent.net.happy_eyeballs import HappyEyeballs
from robotether_agent.net.http_proxy import DEAD_ADVICE, Proxy, ask_for
from robotether_agent.net.tcp import Resolver, connect, is_established, peek
from robotether_agent.problems import (
    AgentError,
    NoAnswerError,
    ServerBusyError,
    ServerUnreachableError,
)
from robotether_agent.tasks import first_of, within

SSH = b"SSH-"
# What sshd says in place of its banner when it lets no further log-in begin: OpenSSH 10, and those before it.
FULL = (b"Not allowed at this time", b"Exceeded MaxStartups")
CLIENT_BANNER = b"SSH-2.0-robotether\r\n"
# Time after which the client speaks first. A server that speaks first does so after one round trip,
# unless it is overloaded, and a wrong guess costs it a second connection. At ports that are known
# to wait the client speaks at once.
SPEAK_AFTER_S = 6.0
# Time limit for a banner, even of an overloaded server.
BANNER_TIMEOUT_S = 15.0
HTTPS = 443
# Delay before the next port is tried, for a network that drops packets to the first one.
NEXT_PORT_AFTER_S = 0.5
# Delay before the next cell is tried; a slow cell usually answers sooner.
NEXT_CELL_AFTER_S = 2.0
# Interval between fresh attempts while nothing answers; the kernel's own retries soon become rare.
TRY_EVERY_S = (0.4, 0.6)
# Delay before the next port and attempt while a connection is silent. A server that accepts a
# connection but stays silent is overloaded; retrying adds load, and frequent retries of many robots
# keep it from ever answering.
BUSY_NEXT_PORT_AFTER_S = 6.0
BUSY_TRY_AFTER_S = (5.0, 7.0)
BUSY_FIND_TIMEOUT_S, BUSY_ANSWER_S = 15.0, 0.5
# Delay before the next cell is tried when one is silent, random so that a fleet does not leave a
# busy cell all at once. A machine that hangs looks the same, and its robots must be drivable
# elsewhere within 5 s; each robot tries each cell once.
BUSY_NEXT_CELL_AFTER_S = (2.0, 4.0)
# Delay after a change of the network until addresses and routes have settled.
SETTLED_AFTER_S = 0.05
# Time limit for finding a server with one cell, after which the caller may retry.
FIND_TIMEOUT_S = 5.0
SPARE_S = 3.0

log = logging.getLogger(__name__)


class Banner:
    """Which of the server's ports speak only when spoken to."""

    def __init__(self, https_port: int = HTTPS) -> None:
        # Where the site is, nginx is in front of sshd.
        self._silent_ports = {HTTPS, https_port}

    def waits_at(self, port: int) -> bool:
        """Return whether the port is known to wait for the client's first word."""
        return port in self._silent_ports

    async def check(self, connection: socket.socket, port: int, name: str) -> bool:
        """Return whether the connection is unused still; raise a problem if no SSH server is there."""
        try:
            if port not in self._silent_ports and await _receives_ssh(
                connection, SPEAK_AFTER_S, name
            ):
                return True
            connection.send(CLIENT_BANNER)
            if not await _receives_ssh(connection, BANNER_TIMEOUT_S, name):
                why = "it accepts the connection but stays silent"
                raise NoAnswerError(f"cannot reach SSH at {name}: {why}", advice=SILENT_ADVICE)
        except OSError as error:
            raise _closed(name) from error
        self._silent_ports.add(port)
        return False


async def _receives_ssh(connection: socket.socket, timeout_s: float, name: str) -> bool:
    try:
        words = await within(timeout_s, peek(connection, lambda words: len(words) >= len(SSH), 64))
    except asyncio.TimeoutError:
        return False
    if not words.startswith(SSH):
        raise _no_ssh(name, words)
    return True


def _closed(name: str) -> AgentError:
    return ServerUnreachableError(
        f"cannot reach SSH at {name}: it closes the connection silently",
        advice="see that the server is up and not overloaded; this is tried again",
    )


def _no_ssh(name: str, words: bytes) -> AgentError:
    if words.startswith(FULL):
        return ServerBusyError(
            f"cannot log in at {name} now: it already handles as many log-ins as it accepts at once"
        )
    line = printable(words.decode("ascii", errors="replace").split("\r\n")[0], 60)
    return ServerUnreachableError(
        f"cannot reach SSH at {name}: what answers there is not an SSH server ({line!r})",
        advice="find out what is in between, such as a captive portal, and log in to it",
    )


@dataclass(frozen=True)
class SshAddress:
    """One SSH address of the server, and who knows the way to it; without, it is gone straight.

    Addresses of one `cell` lead to the same machine.
    """

    host: str
    port: int
    user: str
    dialer: ServerDialer | None = field(default=None, compare=False, repr=False)
    cell: ListedCell | None = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        return f"{self.host} port {self.port}"


@dataclass
class _Probe:
    """An SSH server answers at `target`; the connection is there if nobody has said a word on it."""

    target: SshAddress
    connection: socket.socket | None
    since: float = field(default_factory=monotonic)

    def is_fresh(self) -> bool:
        """Return whether the server still waits for the first word on it."""
        if self.connection is None or monotonic() - self.since > SPARE_S:
            return False
        return is_established(self.connection)

    def drop(self) -> None:
        """Let the connection go."""
        if self.connection is not None:
            self.connection.close()


@dataclass
class _Candidate:
    """One cell: its addresses, and its refusal, after which it is not asked again while others are waited for."""

    addresses: list[SshAddress]
    refusal: ServerUnreachableError | None = None


class ServerDialer:
    """How to get a connection to one of the server's SSH ports."""

    def __init__(
        self,
        proxy: Proxy | None = None,
        *,
        rng: Random | None = None,
        resolver: Resolver | None = None,
        https_port: int = HTTPS,
    ) -> None:
        self._proxy = proxy
        self._rng = rng or Random()  # noqa: S311 - spreads a fleet, keeps no secret
        self._resolver = resolver or Resolver()
        self._banner = Banner(https_port)
        self._spares: list[_Probe] = []
        # Connections that the other end has taken, and on which it has said nothing yet.
        self._silent_connections = 0
        self._none_silent = asyncio.Event()
        self._none_silent.set()
        # An agent that ends between a find and an open must leave no connection.
        weakref.finalize(self, _drop_all, self._spares)

    @property
    def is_proxied(self) -> bool:
        """Whether the other end of a connection is a proxy and not the server."""
        return self._proxy is not None

    async def find(self, targets: Sequence[SshAddress], *, unreached_s: float = 0.0) -> SshAddress:
        """Return the first of the targets at which an SSH server answers, and keep the connection for `open`.

        The addresses of a cell stand side by side. The next cell is tried too when one refuses, is busy, or does not
        answer for NEXT_CELL_AFTER_S, of which the first has had `unreached_s`. Raises ServerUnreachableError when
        something refuses, and NoAnswerError after FIND_TIMEOUT_S of silence, or after BUSY_FIND_TIMEOUT_S of it on a
        connection that is up; each further cell has its own time before that.
        """
        cells = [
            _Candidate(list(addresses))
            for _, addresses in groupby(targets, key=lambda target: target.cell)
        ]
        for spare in self._spares:
            if spare.target in targets and spare.is_fresh():
                return spare.target
        with netlink.listening() as network:
            happy_eyeballs = HappyEyeballs(
                repeat(partial(self._probe_any, cells, unreached_s)),
                pause=partial(self._pause, network),
                drop=_Probe.drop,
                eager=False,
            )
            target: SshAddress | None = await first_of(
                self._keep_winner(happy_eyeballs), self._give_up(len(cells))
            )
            if target is None:
                raise happy_eyeballs.problem
            return target

    async def open(self, target: SshAddress) -> socket.socket:
        """Return a connection to `target`: the one in hand, or a new one."""
        for spare in [item for item in self._spares if item.target == target]:
            self._spares.remove(spare)
            if spare.connection is not None and spare.is_fresh():
                return spare.connection
            spare.drop()
        return await self._connect(target)

    async def round_trips_s(self, cell: ListedCell, count: int) -> list[float]:
        """Return how long TCP connections to a cell took, one after the other; raises as `open` does.

        Where it can be, at nginx's port: sshd counts whom it lets begin. Through a proxy with its own round trip.
        """
        port = next((port for port in cell.ports if self._banner.waits_at(port)), cell.ports[0])
        target = SshAddress(cell.host, port, "")
        # The name service and a family that leads nowhere have their time before.
        with closing(await self._connect(target)) as first:
            if self._proxy is None:
                target = replace(target, host=first.getpeername()[0])
        trips_s: list[float] = []
        for _ in range(count):
            began = monotonic()
            (await self._connect(target)).close()
            trips_s.append(monotonic() - began)
        return trips_s

    async def _keep_winner(self, happy_eyeballs: HappyEyeballs[_Probe]) -> SshAddress:
        probed = await happy_eyeballs.winner()
        _drop_all(self._spares)
        self._spares.append(probed)
        asyncio.get_running_loop().call_later(SPARE_S, self._expire, probed)
        return probed.target

    def _expire(self, spare: _Probe) -> None:
        if spare in self._spares:
            self._spares.remove(spare)
            spare.drop()

    async def _probe_any(self, cells: Sequence[_Candidate], unreached_s: float) -> _Probe:
        first_s = max(0.0, NEXT_CELL_AFTER_S - unreached_s)
        pauses_s = chain([first_s], repeat(NEXT_CELL_AFTER_S))
        happy_eyeballs = HappyEyeballs(
            [partial(self._probe_cell, cell) for cell in cells],
            pause=lambda: self._pause_before_cell(next(pauses_s)),
            drop=_Probe.drop,
            # Another cell is another machine, which may have room.
            ends=(),
        )
        return await happy_eyeballs.winner()

    async def _probe_cell(self, cell: _Candidate) -> _Probe:
        if cell.refusal is not None:
            raise cell.refusal
        attempts = [partial(self._probe, address) for address in cell.addresses]
        happy_eyeballs = HappyEyeballs(attempts, pause=self._pause_before_port, drop=_Probe.drop)
        try:
            return await happy_eyeballs.winner()
        except ServerUnreachableError as problem:
            cell.refusal = problem
            raise

    async def _probe(self, target: SshAddress) -> _Probe:
        connection = await self._connect(target)
        with _closed_on_failure(connection), self._counted_silent():
            is_unused = await self._banner.check(connection, target.port, self._name(target))
        if not is_unused:
            connection.close()
        return _Probe(target, connection if is_unused else None)

    async def _connect(self, target: SshAddress) -> socket.socket:
        if self._proxy is None:
            return await connect(target.host, target.port, self._resolver, f"SSH at {target}")
        proxy = self._proxy
        connection = await connect(*proxy.address, self._resolver, str(proxy), DEAD_ADVICE)
        with _closed_on_failure(connection):
            await ask_for(connection, proxy, target.host, target.port)
        return connection

    def _name(self, target: SshAddress) -> str:
        return str(target) if self._proxy is None else f"{target} through {self._proxy}"

    @contextmanager
    def _counted_silent(self) -> Iterator[None]:
        self._silent_connections += 1
        self._none_silent.clear()
        try:
            yield
        finally:
            self._silent_connections -= 1
            if not self._silent_connections:
                self._none_silent.set()

    async def _give_up(self, cells: int) -> None:
        silence_s = FIND_TIMEOUT_S + (cells - 1) * NEXT_CELL_AFTER_S
        busy_s = BUSY_FIND_TIMEOUT_S + (cells - 1) * BUSY_NEXT_CELL_AFTER_S[1]
        await asyncio.sleep(silence_s)
        with suppress(asyncio.TimeoutError):
            await within(busy_s - silence_s, self._none_silent.wait())
            # The last one may have ended because it was answered, of which HappyEyeballs knows a little later.
            await asyncio.sleep(BUSY_ANSWER_S)

    async def _pause_before_port(self) -> None:
        await asyncio.sleep(NEXT_PORT_AFTER_S)
        if self._silent_connections:
            await asyncio.sleep(BUSY_NEXT_PORT_AFTER_S - NEXT_PORT_AFTER_S)

    async def _pause_before_cell(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
        if self._silent_connections:
            await asyncio.sleep(self._rng.uniform(*BUSY_NEXT_CELL_AFTER_S) - seconds)

    async def _pause(self, network: netlink.Network) -> None:
        """Wait until the next attempt is due, or the network may be another one."""

        async def is_due() -> None:
            await asyncio.sleep(self._rng.uniform(*TRY_EVERY_S))
            if self._silent_connections:
                await asyncio.sleep(self._rng.uniform(*BUSY_TRY_AFTER_S))

        async def has_changed() -> None:
            await network.changed()
            await asyncio.sleep(SETTLED_AFTER_S)

        await first_of(is_due(), has_changed())


@contextmanager
def _closed_on_failure(connection: socket.socket) -> Iterator[None]:
    with ExitStack() as unless_done:
        unless_done.callback(connection.close)
        yield
        unless_done.pop_all()


def _drop_all(spares: list[_Probe]) -> None:
    while spares:
        spares.pop().drop()
