"""A virtual robot: what an agent says to the server, without the programs of a robot; hundreds fit into a process.

Played by paper.fleet.worker and paper.cells.worker. Its SSH connections are asyncssh's, with the agent's own session
and forwards; they are dialled and tried again by the agent's own rules, at the cells of the server's newest list, of
which it keeps none on disk. What lies behind its forwards, and what it says as a guard, is services.py. It has no guard
that could stop anything, no camera, no battery, no shell, and does not rotate its key: never let one stand for a robot
that moves. Its key exchange is the newest of OpenSSH 10's that both ends know.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from random import Random
from typing import Any, NoReturn, Protocol

import asyncssh
from asyncssh.constants import MSG_IGNORE
from asyncssh.forward import SSHForwarder
from robotether_agent import __version__
from robotether_agent.backoff import Backoff, Uptime, keep_going
from robotether_agent.clock import EpochClock, robot_time
from robotether_agent.enrolment import keys
from robotether_agent.enrolment.enroller import EnrolmentStore
from robotether_agent.enrolment.join import SshAccess
from robotether_agent.net.server_dialer import NEXT_CELL_AFTER_S, ServerDialer, SshAddress
from robotether_agent.net.tcp import Address, Resolver, resolve
from robotether_agent.problems import (
    AgentError,
    ForwardFailedError,
    KeyRefusedError,
    LinkLostError,
    PortTakenError,
    ServerSilentError,
    SessionEndedError,
)
from robotether_agent.settings import Settings
from robotether_agent.tasks import first_of
from robotether_agent.tunnel.connection import (
    Role,
    _ask_for_checks,
    _keep_forward,
    _leave_silent_relay,
)
from robotether_agent.tunnel.connector import has_no_relay
from robotether_agent.tunnel.openssh import Forward, ServiceAddress
from robotether_agent.tunnel.session import (
    DriveMessageHandler,
    RequestedFeatures,
    Session,
    SessionConfig,
)
from robotether_common.session import MAX_LINE_BYTES, Kind

ANY_ADDRESS = "0.0.0.0"  # the server's own, as `ssh -R` names it
LOGIN_WITHIN_S = 60.0
# What OpenSSH 10 offers first; with an older sshd it is curve25519. The cipher is its second choice, as asyncssh makes
# three contexts a packet for the first; sshd needs about as long for either.
KEY_EXCHANGES = ["mlkem768x25519-sha256", "curve25519-sha256"]
CIPHERS = ["aes256-gcm@openssh.com"]
HEALTH = {"type": "health", "ros": "ok", "video": "ok", "detail": "", "ros_exposed": False}


class Side(DriveMessageHandler, Protocol):
    """What a virtual robot has behind its forwards, and what speaks as its guard."""

    # Set when the forward may lead somewhere else now.
    moved: asyncio.Event

    def ros_target(self) -> ServiceAddress | None:
        pass

    def topics_target(self) -> ServiceAddress | None:
        pass

    async def report(self, session: Session) -> None:
        pass


class Numeric(Resolver):
    """Takes addresses only, which needs no thread for each connection."""

    async def addresses(self, host: str, port: int) -> list[Address]:
        return resolve(host, port)


@dataclass(frozen=True)
class Account:
    settings: Settings
    ssh: SshAccess
    dialer: ServerDialer
    options: asyncssh.SSHClientConnectionOptions

    def targets(self) -> list[SshAddress]:
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
        # No file or agent of this machine's user takes part.
        options = asyncssh.SSHClientConnectionOptions(
            username=enrolment.ssh.user,
            client_keys=[asyncssh.read_private_key(state / keys.NAME)],
            known_hosts=(_pinned((state / keys.KNOWN_HOSTS).read_text()), [], []),
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
        dialer = ServerDialer(resolver=Numeric())
        return cls(Settings(server=settings["server"]), enrolment.ssh, dialer, options)


@lru_cache(maxsize=8)
def _pinned(known_hosts: str) -> list[asyncssh.SSHKey]:
    """The keys of a known_hosts file, which is the same for all robots of a server."""
    lines = (line.split(None, 1)[1] for line in known_hosts.splitlines())
    return [asyncssh.import_public_key(line) for line in lines]


_send_packet = asyncssh.SSHClientConnection.send_packet
_forward_connection = asyncssh.SSHClientConnection.forward_connection


def _send(connection: asyncssh.SSHClientConnection, kind: int, *args: bytes, **more: Any) -> None:
    """Leave out the empty packet that asyncssh puts before each other one: it doubles what a server has to read.

    OpenSSH's client sends none either, and asyncssh has no setting for it.
    """
    if kind != MSG_IGNORE:
        _send_packet(connection, kind, *args, **more)


async def _forward(connection: asyncssh.SSHClientConnection, *args: Any) -> SSHForwarder:
    """Close what was opened to a service while the SSH connection ended: asyncssh forgets it open, at both its ends."""
    forwarder = await _forward_connection(connection, *args)
    if connection.is_closed():
        forwarder.close()
    return forwarder


asyncssh.SSHClientConnection.send_packet = _send  # type: ignore[method-assign, assignment]
asyncssh.SSHClientConnection.forward_connection = _forward  # type: ignore[method-assign, assignment]


class VirtualTunnel(asyncssh.SSHClientSession[bytes]):
    """A connection as the agent's Tunnel is one, and its session's writer."""

    # None is used before.
    is_logged_in = True

    def __init__(self, target: SshAddress) -> None:
        self.lines_in = asyncio.StreamReader(limit=MAX_LINE_BYTES)
        self.lines_out = self
        self._target = target
        self._ssh: asyncssh.SSHClientConnection
        self._channel: asyncssh.SSHClientChannel[bytes]
        self._forwards: dict[Forward, asyncssh.SSHListener] = {}
        self._why = "without a word"

    @classmethod
    async def open(cls, account: Account, target: SshAddress, kind: Kind) -> VirtualTunnel:
        """Log in and ask for a session of this kind; the agent's problems say why not."""
        tunnel = cls(target)
        sock = await account.dialer.open(target)
        try:
            tunnel._ssh = await asyncssh.connect(sock=sock, options=account.options)
        except asyncssh.PermissionDenied as error:
            raise KeyRefusedError(f"cannot log in at {target}: {error}") from error
        except (asyncssh.Error, OSError) as error:
            raise LinkLostError(f"cannot log in at {target}: {error}") from error
        try:
            await tunnel._ssh.create_session(lambda: tunnel, kind, encoding=None)
        except (asyncssh.Error, OSError) as error:
            tunnel._ssh.abort()
            raise LinkLostError(f"cannot open the session at {target}: {error}") from error
        return tunnel

    async def add(self, forward: Forward) -> None:
        port = forward.listen_port
        try:
            self._forwards[forward] = await self._ssh.forward_remote_port(
                ANY_ADDRESS, port, forward.host, forward.port
            )
        except asyncssh.ChannelListenError as error:
            raise PortTakenError(f"cannot open port {port} on the server: {error}") from error
        except (asyncssh.Error, OSError) as error:
            raise ForwardFailedError(f"cannot open port {port} on the server: {error}") from error

    async def cancel(self, forward: Forward) -> None:
        self._forwards.pop(forward).close()

    def on_connected(self) -> None:
        """Nothing that was said before counts."""

    def why_ended(self) -> AgentError:
        return LinkLostError(f"lost the connection to {self._target}: {self._why}")

    async def close(self) -> None:
        self._ssh.abort()
        with suppress(asyncssh.Error, OSError):
            await self._ssh.wait_closed()

    # As a writer.

    @property
    def transport(self) -> asyncssh.SSHClientChannel[bytes]:
        return self._channel

    def write(self, data: bytes) -> None:
        if not self._channel.is_closing():
            self._channel.write(data)

    # What asyncssh calls.

    def connection_made(self, chan: asyncssh.SSHClientChannel[bytes]) -> None:
        self._channel = chan

    def data_received(self, data: bytes, datatype: int | None) -> None:
        # The other kind has the session command's last words.
        if datatype is None:
            self.lines_in.feed_data(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._why = str(exc or self._why)
        self.lines_in.feed_eof()


class VirtualRobot:
    """One robot; connected for as long as `run` is awaited."""

    def __init__(self, account: Account, side: Side, rng: Random) -> None:
        self._account, self._side, self._rng = account, side, rng
        self._epochs = EpochClock()
        self._epoch = 0
        self._features = RequestedFeatures(allows_shell=False)
        # The server's own view of the forwards may be another one.
        self._recheck = asyncio.Event()
        self._up, self._down = asyncio.Event(), asyncio.Event()
        self._at: SshAddress
        # When an address last led to no session, for those since the last one; and the one that fell silent last.
        self._failed_at: dict[SshAddress, float] = {}
        self._fell_silent: SshAddress | None = None
        # Called when a session is up, with its address and epoch, and when it is lost.
        self.on_session: Callable[[SshAddress, int], None] = lambda _target, _epoch: None
        self.on_session_lost: Callable[[], None] = lambda: None

    async def run(self) -> None:
        """Keep a session, and topics beside it; ends with the problem that no retry mends."""
        works = {"session": self._session_attempt, "video tunnel": self._media_attempt}
        await first_of(
            *(
                keep_going(what, attempt, Backoff(self._rng), lambda _: None, asyncio.sleep)
                for what, attempt in works.items()
            )
        )

    async def _session_attempt(self, uptime: Uptime) -> None:
        # As the agent: a cell that let the robot begin, and led to no session, comes after the others.
        targets = self._account.targets()
        targets.sort(key=lambda item: self._failed_at.get(item, 0.0))
        # One that fell silent has had its time to answer.
        unreached_s = NEXT_CELL_AFTER_S if targets[0] == self._fell_silent else 0.0
        self._fell_silent = None
        self._at = target = await self._account.dialer.find(targets, unreached_s=unreached_s)
        role = Role(
            kind="session",
            target=self._side.ros_target,
            moved=self._side.moved,
            on_up=partial(self._is_up, uptime),
            reports=(self._report,),
            elsewhere=lambda: targets[1:],
            recheck=self._recheck,
            guard=self._side,
            on_config=self._on_config,
        )
        try:
            await self._connect(role, uptime)
        except AgentError as problem:
            if isinstance(problem, ServerSilentError):
                self._fell_silent = target
            if has_no_relay(problem):
                self._failed_at[target] = robot_time()
            raise
        finally:
            self._up.clear()
            self._down.set()
            self.on_session_lost()

    async def _media_attempt(self, uptime: Uptime) -> None:
        await self._features.media.wait()
        await self._up.wait()
        number = self._features.media.number
        role = Role(kind="media", target=self._side.topics_target, on_up=lambda *_: uptime.is_up())
        try:
            await first_of(self._connect(role, uptime), self._down.wait())
        except SessionEndedError as problem:
            if problem.code != "unwatched":
                raise
            self._features.media.end(number)

    async def _connect(self, role: Role, uptime: Uptime) -> NoReturn:
        """Connect where the session is, and serve until an AgentError is raised, as the agent's run_connection."""
        tunnel = await VirtualTunnel.open(self._account, self._at, role.kind)
        session = Session(
            tunnel.lines_in,
            tunnel.lines_out,  # type: ignore[arg-type]  # a writer that has what it needs
            drive_handler=role.guard,
            on_config=role.on_config,
        )
        if role.kind == "session":
            self._failed_at[self._at] = robot_time()
        checks = [] if role.recheck is None else [_ask_for_checks(session, role.recheck)]
        try:
            await first_of(
                session.run(),
                _keep_forward(tunnel, session, role, self._at),  # type: ignore[arg-type] # as Tunnel
                _leave_silent_relay(tunnel, session, role, self._at),  # type: ignore[arg-type]
                *(report(session) for report in role.reports),
                *checks,
            )
            raise tunnel.why_ended()
        finally:
            if role.guard is not None:
                uptime.was_used = session.is_used
                role.guard.on_session_lost()
            await tunnel.close()

    def _on_config(self, config: SessionConfig) -> None:
        self._features.apply(config)
        if config.cells:
            ssh = replace(self._account.ssh, cells=config.cells)
            self._account = replace(self._account, ssh=ssh)

    def _is_up(self, uptime: Uptime, target: SshAddress, *_: object) -> None:
        uptime.is_up()
        self._failed_at.clear()
        self._down.clear()
        self._up.set()
        self._recheck.set()
        self.on_session(target, self._epoch)

    async def _report(self, session: Session) -> None:
        self._epoch = self._epochs.next()
        who = {"hostname": socket.gethostname(), "agent_version": __version__}
        session.send({"type": "hello", **who, "guard": "on", "epoch": self._epoch})
        await session.new_config(None)
        session.send(HEALTH)
        await self._side.report(session)
