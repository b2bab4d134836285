"""One connection of a kind (session, media or shell), from the dial to its forward.

Used by the daemon, one of each kind, so that control never waits behind video or a file copy. A connection ends with
the problem that ended it; it never tries again by itself. The port that worked last is tried first. While nothing
answers the web is asked now and then where the server is, beside the attempts, which never wait for that.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Callable, Coroutine, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from time import monotonic
from typing import Any, NoReturn, Protocol

from robotether_common.session import Kind

from robotether_agent.enrolment.enroller import Enroller, Enrolment
from robotether_agent.enrolment.keys import KeyPair
from robotether_agent.net.happy_eyeballs import combined_problem
from robotether_agent.net.http_proxy import proxy_of
from robotether_agent.net.server_dialer import ServerDialer, SshAddress
from robotether_agent.problems import AgentProblem, NoAnswer, ServerUnreachable
from robotether_agent.settings import Settings
from robotether_agent.tasks import first_of, within
from robotether_agent.tunnel import liveness
from robotether_agent.tunnel.openssh import Forward, SshFiles
from robotether_agent.tunnel.session import DriveMessageHandler, Session, SessionConfig
from robotether_agent.tunnel.tunnel import Tunnel

# The server answers at most once in 5 s.
CHECK_PAUSE_S = 5.5
CHECK_EVERY_S = 60.0
# Of a robot that nobody uses, only its own status shows what they find.
IDLE_CHECK_EVERY_S = 600.0


Report = Callable[[Session], Coroutine[Any, Any, None]]
# A cut is mostly the network's: only after a longer one the server may have moved.
ASK_WEB_AFTER_S = 15.0
ASK_WEB_EVERY_S = 30.0

log = logging.getLogger(__name__)


class PacedStreams(Protocol):
    """What sends its streams as fast as a connection takes them."""

    def use(self, connection: socket.socket | None) -> None:
        """Pace by this connection from now on."""

    def hold(self) -> None:
        """Send nothing until the next `use`: the connection ends."""


@dataclass(frozen=True, kw_only=True)
class Role:
    """What a connection of one kind is for."""

    kind: Kind
    # The forward that a configuration asks for on this connection, if any.
    forward: Callable[[SessionConfig], Forward | None]
    # Set when the same configuration may ask for another forward now.
    moved: asyncio.Event = field(default_factory=asyncio.Event)
    # Called when the forward is up, for the first time and after each change.
    on_up: Callable[[SshAddress, SessionConfig, Session], None]
    # Reports to the server how the robot is, for as long as the connection lasts; on the session only.
    reports: Sequence[Report] = ()
    # Set when the server's own view of the forwards may be another one; on the session only.
    recheck: asyncio.Event | None = None
    # What paces the streams on this connection by how it does; on the media one only.
    video_proxy: PacedStreams | None = None
    # What stops the robot, joined to the session only; None is a bare forward.
    guard: DriveMessageHandler | None = None


async def run_connection(target: SshAddress, files: SshFiles, role: Role) -> NoReturn:
    """Connect, keep the forward, and serve the session until an AgentProblem is raised."""
    tunnel = await Tunnel.open(target, files, role.kind)
    try:
        if role.video_proxy is not None:
            role.video_proxy.use(tunnel.socket)
        session = Session(tunnel.lines_in, tunnel.lines_out, drive_handler=role.guard)
        await first_of(*_work(tunnel, session, role, target))
        raise await tunnel.why_ended(was_connected=session.config is not None)
    finally:
        if role.guard is not None:
            # Before the client ends, which may take seconds.
            role.guard.on_session_lost()
        if role.video_proxy is not None:
            role.video_proxy.hold()
        await tunnel.close()


def _work(
    tunnel: Tunnel, session: Session, role: Role, target: SshAddress
) -> list[Coroutine[Any, Any, None]]:
    work = [
        session.run(),
        _keep_forward(tunnel, session, role, target),
        liveness.watch(session, tunnel, target),
        *(report(session) for report in role.reports),
    ]
    if role.recheck is not None:
        work.append(_ask_for_checks(session, role.recheck))
    return work


async def _keep_forward(tunnel: Tunnel, session: Session, role: Role, target: SshAddress) -> None:
    """Make the live connection's forward follow the configuration, and the guard's port."""
    open_now: Forward | None = None
    reported: tuple[SessionConfig, Forward | None] | None = None
    config = await session.new_config(None)
    while True:
        role.moved.clear()
        wanted = role.forward(config)
        if wanted != open_now:
            if open_now is not None:
                await tunnel.cancel(open_now)
            if wanted is not None:
                await tunnel.add(wanted)
                _log_forward(config, wanted)
        open_now = wanted
        if reported != (config, wanted):
            role.on_up(target, config, session)
            reported = (config, wanted)
        config = await _next_config(session, config, role.moved)


async def _next_config(
    session: Session, known: SessionConfig, moved: asyncio.Event
) -> SessionConfig:
    """Return the newest configuration when it, or where its forward leads, is another one."""

    async def new_config() -> None:
        await session.new_config(known)

    async def has_moved() -> None:
        await moved.wait()

    await first_of(new_config(), has_moved())
    return session.config or known


def _log_forward(config: SessionConfig, forward: Forward) -> None:
    log.info(
        "robot %s: port %d of the server leads to %s:%d",
        config.robot,
        forward.listen_port,
        forward.host,
        forward.port,
    )


async def _ask_for_checks(session: Session, recheck: asyncio.Event) -> None:
    """Ask how the robot looks from the server: when a forward is up, and now and then."""
    await recheck.wait()
    while True:
        recheck.clear()
        session.send({"type": "check"})
        await asyncio.sleep(CHECK_PAUSE_S)
        every_s = IDLE_CHECK_EVERY_S if session.idle_delay_s else CHECK_EVERY_S
        with suppress(asyncio.TimeoutError):
            await within(every_s - CHECK_PAUSE_S, recheck.wait())


class Connector:
    """Where the server is, and which of its ports is let through on this network."""

    def __init__(self, settings: Settings, enroller: Enroller) -> None:
        self._settings = settings
        self._enroller = enroller
        self._good_port: int | None = None
        self._server_dialer = ServerDialer(
            proxy_of(settings.http_proxy), https_port=settings.server_port
        )
        self._silent_since: float | None = None
        self._asked_at = 0.0

    async def connect(self, enrolment: Enrolment, key: KeyPair, role: Role) -> None:
        """Connect where the server answers; raise what ended the connection."""
        coming = await self._enroller.next_key()
        # The server may know either of them when a change of keys was cut short.
        keys = (key.path,) if coming is None else (key.path, coming.path)
        control = self._settings.run_dir / f"{role.kind}.ctl"
        files = SshFiles(keys, self._enroller.known_hosts, control)
        left = self.targets(enrolment)
        failed: list[AgentProblem] = []
        while left:
            try:
                target = await self._find(left)
            except (NoAnswer, ServerUnreachable) as problem:
                raise combined_problem([*failed, problem]) from problem
            left.remove(target)
            failed.append(await self._unless_unreachable(target, files, role))
        raise combined_problem(failed)

    def targets(self, enrolment: Enrolment) -> list[SshAddress]:
        """Return the server's SSH addresses in the order in which they are tried."""
        settings, ssh = self._settings, enrolment.ssh
        host = settings.ssh_host or ssh.host or settings.server_host
        ports = settings.ssh_ports or ssh.ports
        in_order = sorted(ports, key=lambda port: port != self._good_port)
        return [SshAddress(host, port, ssh.user, self._server_dialer) for port in in_order]

    async def _find(self, targets: list[SshAddress]) -> SshAddress:
        """Return where the server answers, and know since when it did not."""
        found: list[SshAddress] = []

        async def find() -> None:
            found.append(await self._server_dialer.find(targets))

        try:
            await first_of(find(), *([self._ask_web()] if self._is_silent_for_long() else []))
        except NoAnswer:
            self._silent_since = self._silent_since or monotonic()
            raise
        except ServerUnreachable:
            self._silent_since = None
            raise
        self._silent_since = None
        return found[0]

    def _is_silent_for_long(self) -> bool:
        now, since = monotonic(), self._silent_since
        if since is None or now - since < ASK_WEB_AFTER_S or now - self._asked_at < ASK_WEB_EVERY_S:
            return False
        self._asked_at = now
        return True

    async def _ask_web(self) -> None:
        """Learn the server's address and ports again, if the web answers; the next attempt goes by them."""
        await self._enroller.refresh()
        # Ends with the attempt beside it.
        await asyncio.Event().wait()

    async def _unless_unreachable(
        self, target: SshAddress, files: SshFiles, role: Role
    ) -> ServerUnreachable:
        """Connect to `target`; return only if no SSH server lets us begin there."""

        def on_up(at: SshAddress, config: SessionConfig, session: Session) -> None:
            # On many networks only one of the ports is let out.
            self._good_port = at.port
            role.on_up(at, config, session)

        try:
            await run_connection(target, files, replace(role, on_up=on_up))
        except ServerUnreachable as problem:
            return problem
