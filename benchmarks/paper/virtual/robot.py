"""A virtual robot: what an agent says to the server, without the programs of a robot; hundreds fit into a process.

Played by paper.fleet.worker and paper.cells.worker. Its SSH connection is asyncssh's, dialled and tried again by the
agent's own rules, at the cells of the server's newest list, of which it keeps none on disk; its lines are the agent's,
in the agent's order (benchmarks/tests/test_virtual.py compares them). What lies behind its forwards is services.py. It
has no guard that could stop anything, no camera, no battery, no shell, and does not rotate its key: never let one stand
for a robot that moves. Its key exchange is the newest of OpenSSH 10's that both ends know.
"""

from __future__ import annotations

import asyncio
import json
import logging
import socket
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from random import Random
from typing import Any

import asyncssh
from asyncssh.constants import MSG_IGNORE
from robotether_agent import __version__
from robotether_agent.backoff import Backoff, Uptime, keep_going
from robotether_agent.clock import EpochClock, robot_time
from robotether_agent.enrolment import keys
from robotether_agent.enrolment.enroller import EnrolmentStore
from robotether_agent.enrolment.join import SshAccess
from robotether_agent.fields import get_cells, line_of
from robotether_agent.net.server_dialer import NEXT_CELL_AFTER_S, ServerDialer, SshAddress
from robotether_agent.net.tcp import Address, Resolver, resolve
from robotether_agent.problems import (
    AgentError,
    ForwardFailedError,
    KeyRefusedError,
    LinkLostError,
    PortTakenError,
    ProtocolBrokenError,
    ServerSilentError,
    SessionEndedError,
)
from robotether_agent.settings import Settings
from robotether_agent.tunnel.connection import (
    CHECK_EVERY_S,
    CHECK_PAUSE_S,
    IDLE_CHECK_EVERY_S,
    RELAY_ANSWERS_WITHIN_S,
)
from robotether_agent.tunnel.connector import has_no_relay
from robotether_agent.tunnel.session import FIRST_TIMEOUT_S, retry_after_bye
from robotether_common.session import Kind

from paper.virtual.services import Services

ANY_ADDRESS = "0.0.0.0"  # the server's own, as `ssh -R` names it
LOGIN_WITHIN_S = 60.0
MEDIA_PAUSE_S = 0.2
# What OpenSSH 10 offers first; with an older sshd it is curve25519. The cipher is its second choice, as asyncssh makes
# three contexts a packet for the first; sshd needs about as long for either.
KEY_EXCHANGES = ["mlkem768x25519-sha256", "curve25519-sha256"]
CIPHERS = ["aes256-gcm@openssh.com"]
Line = Mapping[str, Any]
log = logging.getLogger(__name__)


class Numeric(Resolver):
    """Takes addresses only, which needs no thread for each connection."""

    async def addresses(self, host: str, port: int) -> list[Address]:
        return resolve(host, port)


@dataclass(frozen=True)
class Account:
    """Where a robot logs in, and with what; read from the files of its enrolment."""

    settings: Settings
    ssh: SshAccess
    dialer: ServerDialer
    options: asyncssh.SSHClientConnectionOptions

    def targets(self) -> list[SshAddress]:
        """The first port of each cell, in the order in which they are tried."""
        return [
            SshAddress(cell.host, cell.ports[0], self.ssh.user, self.dialer, cell)
            for cell in self.ssh.in_order(self.settings)
        ]

    @classmethod
    def read(cls, settings: Mapping[str, str]) -> Account:
        """`settings` are the agent's `server` and `state_dir`; the robot must have joined."""
        state = Path(settings["state_dir"])
        enrolment = EnrolmentStore(state).load(settings["server"])
        if enrolment is None:
            raise ValueError(f"{state} has no enrolment at {settings['server']}")
        options = login_options(
            enrolment.ssh.user,
            asyncssh.read_private_key(state / keys.NAME),
            (state / keys.KNOWN_HOSTS).read_text(),
        )
        dialer = ServerDialer(resolver=Numeric())
        return cls(Settings(server=settings["server"]), enrolment.ssh, dialer, options)


@lru_cache(maxsize=8)
def _pinned(known_hosts: str) -> list[asyncssh.SSHKey]:
    """The keys of a known_hosts file, which is the same for all robots of a server."""
    lines = (line.split(None, 1)[1] for line in known_hosts.splitlines())
    return [asyncssh.import_public_key(line) for line in lines]


def login_options(
    user: str, key: asyncssh.SSHKey, known_hosts: str
) -> asyncssh.SSHClientConnectionOptions:
    """No file or agent of this machine's user takes part."""
    return asyncssh.SSHClientConnectionOptions(
        username=user,
        client_keys=[key],
        known_hosts=(_pinned(known_hosts), [], []),
        config=None,
        agent_path=None,
        gss_host=None,
        preferred_auth="publickey",
        kex_algs=KEY_EXCHANGES,
        encryption_algs=CIPHERS,
        mac_algs=["hmac-sha2-256-etm@openssh.com"],
        compression_algs=["none"],
        server_host_key_algs=["ssh-ed25519"],
        login_timeout=LOGIN_WITHIN_S,
    )


def _without_ignored(send_packet: Callable[..., None]) -> Callable[..., None]:
    """Leave out the empty packet that asyncssh puts before each other one: it doubles what a server has to read.

    OpenSSH's client sends none either, and asyncssh has no setting for it.
    """

    def send(connection: asyncssh.SSHConnection, kind: int, *args: bytes, **more: Any) -> None:
        if kind != MSG_IGNORE:
            send_packet(connection, kind, *args, **more)

    return send


asyncssh.SSHClientConnection.send_packet = _without_ignored(  # type: ignore[method-assign]
    asyncssh.SSHClientConnection.send_packet
)


class Connection(asyncssh.SSHClientSession[bytes]):
    """One SSH connection, of a session or beside one, with its lines both ways, and its heartbeat."""

    def __init__(self, on_line: Callable[[Connection, Line], None]) -> None:
        self.config: dict[str, Any] = {}
        self.configs = 0
        self.target: SshAddress
        # Of a session.
        self.epoch = 0
        self.ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._on_line = on_line
        self._ssh: asyncssh.SSHClientConnection
        self._channel: asyncssh.SSHClientChannel[bytes] | None = None
        self._rest = b""
        self._seq = 0
        self._first_timeout_s = FIRST_TIMEOUT_S
        self._received_at = robot_time()
        self._timer: asyncio.TimerHandle | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def idle_heartbeat_s(self) -> float | None:
        """The time between heartbeats while nobody uses the robot."""
        return self.config.get("idle_heartbeat_s")

    @property
    def is_used(self) -> bool:
        """Whether the server says that somebody uses the robot."""
        config = self.config
        return bool(config) and self.idle_heartbeat_s is None and not config["direct"]

    async def open(
        self,
        account: Account,
        targets: Sequence[SshAddress],
        *,
        kind: Kind = "session",
        unreached_s: float = 0.0,
    ) -> None:
        """Log in and ask for a session of this kind; the agent's problems say why not."""
        if len(targets) > 1:
            self._first_timeout_s = RELAY_ANSWERS_WITHIN_S
        self.target = target = await account.dialer.find(targets, unreached_s=unreached_s)
        sock = await account.dialer.open(target)
        try:
            self._ssh = await asyncssh.connect(sock=sock, options=account.options)
        except asyncssh.PermissionDenied as error:
            raise KeyRefusedError(f"cannot log in at {target}: {error}") from error
        except (asyncssh.Error, OSError) as error:
            raise LinkLostError(f"cannot log in at {target}: {error}") from error
        try:
            await self._ssh.create_session(lambda: self, kind, encoding=None)
        except (asyncssh.Error, OSError) as error:
            self._ssh.abort()
            raise LinkLostError(f"cannot open the session at {target}: {error}") from error

    async def forward(self, port: int, make: Callable[[], asyncssh.SSHTCPSession[bytes]]) -> None:
        """Have the server listen at `port`; each connection there is a session of `make`."""
        try:
            await self._ssh.create_server(lambda _host, _port: make(), ANY_ADDRESS, port)
        except asyncssh.ChannelListenError as error:
            raise PortTakenError(f"cannot open port {port} on the server: {error}") from error
        except (asyncssh.Error, OSError) as error:
            raise ForwardFailedError(f"cannot open port {port} on the server: {error}") from error

    def send(self, message: Line) -> None:
        if self._channel is not None and not self._channel.is_closing():
            self._channel.write(line_of(message))

    def run(self, work: Any) -> None:
        """Run a coroutine beside the connection; its problem ends it."""
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._done)

    def fail(self, problem: AgentError) -> None:
        """End with this problem; the first one counts."""
        if not self.ended.done():
            self.ended.set_exception(problem)

    async def close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        for task in self._tasks:
            task.cancel()
        self._ssh.abort()
        with suppress(asyncssh.Error, OSError):
            await self._ssh.wait_closed()

    # What asyncssh calls.

    def connection_made(self, chan: asyncssh.SSHClientChannel[bytes]) -> None:
        self._channel = chan

    def session_started(self) -> None:
        self._received_at = robot_time()
        self._tick()

    def data_received(self, data: bytes, datatype: int | None) -> None:
        if datatype is not None:
            # The session command's last words.
            log.debug("session: %r", data)
            return
        self._received_at = robot_time()
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._handle(json.loads(line))

    def connection_lost(self, exc: Exception | None) -> None:
        self.fail(LinkLostError(f"lost the connection: {exc or 'without a word'}"))

    def _handle(self, line: Line) -> None:
        kind = line["type"]
        if kind == "ping":
            self.send({"type": "pong", "seq": line["seq"]})
        elif kind == "config":
            idle = self.idle_heartbeat_s
            self.config, self.configs = dict(line), self.configs + 1
            if idle is not None and self.idle_heartbeat_s is None:
                self._tick()
            self._on_line(self, line)
        elif kind == "bye":
            self.fail(_ending(line))
        elif kind != "pong":
            self._on_line(self, line)

    def configured(self, then: Callable[[], None]) -> None:
        """Begin with heartbeats and `then`, when what came with the configuration has been read, as the agent does."""

        def begin() -> None:
            if not self.ended.done():
                self._tick()
                then()

        asyncio.get_running_loop().call_soon(begin)

    def _tick(self) -> None:
        """Send a heartbeat, and see whether the server is silent."""
        if self._timer is not None:
            self._timer.cancel()
        timeout_s = self.config.get("timeout_s", self._first_timeout_s)
        now = robot_time()
        if now - self._received_at > timeout_s:
            why = f"the server was silent for {timeout_s:g} s"
            self.fail(ServerSilentError(f"lost the session: {why}"))
            return
        if self.config:
            self._seq += 1
            self.send({"type": "ping", "seq": self._seq, "t_ms": round(now * 1000, 3)})
        wait_s = self.idle_heartbeat_s or self.config.get("heartbeat_s", self._first_timeout_s)
        self._timer = asyncio.get_running_loop().call_later(wait_s, self._tick)

    def _done(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            why = error if isinstance(error, AgentError) else ProtocolBrokenError(repr(error))
            self.fail(why)


def _ending(bye: Line) -> SessionEndedError:
    retry = retry_after_bye(bye["code"])
    return SessionEndedError(f"the server ended it: {bye['detail']}", code=bye["code"], retry=retry)


class VirtualRobot:
    """One robot; connected for as long as `run` is awaited."""

    def __init__(self, account: Account, services: Services, rng: Random) -> None:
        self._account = account
        self._services = services
        self._rng = rng
        self._epochs = EpochClock()
        # The server's own view of the forwards may be another one.
        self._recheck = asyncio.Event()
        self._media_wanted = asyncio.Event()
        self._session: Connection | None = None
        self._applied: Line = {}
        # When an address last led to no session, for those since the last one; and the one that fell silent last.
        self._failed_at: dict[SshAddress, float] = {}
        self._fell_silent: SshAddress | None = None
        # Called when a session is up, with its address and epoch, and when it is lost.
        self.on_session: Callable[[SshAddress, int], None] = lambda _target, _epoch: None
        self.on_session_lost: Callable[[], None] = lambda: None
        services.on_guard_changed = self._report_guard

    async def run(self) -> None:
        """Keep a session; ends with the problem that no retry mends."""
        backoff = Backoff(self._rng)
        await keep_going("session", self._session_attempt, backoff, lambda _: None, asyncio.sleep)

    async def _session_attempt(self, uptime: Uptime) -> None:
        connection = Connection(partial(self._on_session_line, uptime))
        # As the agent: a cell that let the robot begin, and led to no session, comes after the others.
        targets = self._account.targets()
        targets.sort(key=lambda item: self._failed_at.get(item, 0.0))
        # One that fell silent has had its time to answer.
        unreached_s = NEXT_CELL_AFTER_S if targets[0] == self._fell_silent else 0.0
        self._fell_silent = None
        await connection.open(self._account, targets, unreached_s=unreached_s)
        self._failed_at[connection.target] = robot_time()
        try:
            self._session = connection
            who = {"hostname": socket.gethostname(), "agent_version": __version__}
            connection.epoch = self._epochs.next()
            connection.send({"type": "hello", **who, "guard": "on", "epoch": connection.epoch})
            await connection.ended
        except AgentError as problem:
            if isinstance(problem, ServerSilentError):
                self._fell_silent = connection.target
            if has_no_relay(problem):
                self._failed_at[connection.target] = robot_time()
            raise
        finally:
            uptime.was_used = connection.is_used
            self._session = None
            self._services.on_session_lost()
            self.on_session_lost()
            await connection.close()

    def _on_session_line(self, uptime: Uptime, connection: Connection, line: Line) -> None:
        kind = line["type"]
        if kind == "config":
            if cells := get_cells(line, "cells"):
                ssh = replace(self._account.ssh, cells=cells)
                self._account = replace(self._account, ssh=ssh)
            self._services.on_config(line["guard"], direct=line["direct"])
            (self._media_wanted.set if line["media"] else self._media_wanted.clear)()
            if connection.configs == 1:
                connection.configured(partial(self._begin_session, uptime, connection))
            else:
                self._apply(connection)
        elif kind == "lease":
            self._services.on_lease(line["fence"], held=line["held"])
        elif kind in ("stop", "release"):
            self._services.on_order(kind, line["id"], line["by"])

    def _begin_session(self, uptime: Uptime, connection: Connection) -> None:
        connection.send(HEALTH)
        self._report_guard(None)
        connection.run(self._open_session(uptime, connection))

    async def _open_session(self, uptime: Uptime, connection: Connection) -> None:
        await connection.forward(connection.config["ros_port"], self._services.ros_channel)
        uptime.is_up()
        self._failed_at.clear()
        self.on_session(connection.target, connection.epoch)
        self._apply(connection)
        connection.run(self._keep_media(connection.target))
        await self._keep_asking_for_checks(connection)

    async def _keep_media(self, target: SshAddress) -> None:
        """Have a connection for topics beside the session while the server wants one."""
        while True:
            await self._media_wanted.wait()
            media = Connection(self._on_media_line)
            with suppress(AgentError):
                await media.open(self._account, [target], kind="media")
                try:
                    await media.ended
                finally:
                    await media.close()
            await asyncio.sleep(MEDIA_PAUSE_S)

    def _on_media_line(self, media: Connection, line: Line) -> None:
        if line["type"] == "config" and media.configs == 1:
            port, make = line["video_port"], self._services.topics_channel
            media.configured(lambda: media.run(media.forward(port, make)))

    def _apply(self, connection: Connection) -> None:
        """Follow a configuration, once the session's forward is up, if more of it is new than the heartbeats."""
        applied, self._applied = self._applied, {**connection.config, "idle_heartbeat_s": None}
        if applied != self._applied:
            self._recheck.set()

    async def _keep_asking_for_checks(self, connection: Connection) -> None:
        while True:
            self._recheck.clear()
            connection.send({"type": "check"})
            await asyncio.sleep(CHECK_PAUSE_S)
            every_s = IDLE_CHECK_EVERY_S if connection.idle_heartbeat_s else CHECK_EVERY_S
            with suppress(TimeoutError):
                async with asyncio.timeout(every_s - CHECK_PAUSE_S):
                    await self._recheck.wait()

    def _report_guard(self, answers: str | None) -> None:
        if self._session is not None:
            self._session.send({"type": "guard", **self._services.guard, "answers": answers})


HEALTH = {"type": "health", "ros": "ok", "video": "ok", "detail": "", "ros_exposed": False}
