"""One connection of a kind (session, media or shell), from the dial to its forward.

Used by the daemon, one of each kind, so that control never waits behind video or a file copy. A connection ends with
the problem that ended it; it never tries again by itself. Where to is connector.py's.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Callable, Coroutine, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NoReturn, Protocol

from robotether_common.services import BY_CONNECTION
from robotether_common.session import Kind

from robotether_agent.net.server_dialer import SshAddress
from robotether_agent.problems import ServerSilentError
from robotether_agent.tasks import first_of, within
from robotether_agent.tunnel import liveness
from robotether_agent.tunnel.openssh import Forward, ServiceAddress, SshFiles
from robotether_agent.tunnel.session import DriveMessageHandler, Session, SessionConfig
from robotether_agent.tunnel.tunnel import Tunnel

# Minimum interval between checks; the server answers at most once in 5 s.
CHECK_PAUSE_S = 5.5
CHECK_EVERY_S = 60.0
# Interval between checks of an idle robot, whose own status alone shows the result.
IDLE_CHECK_EVERY_S = 600.0
# Time limit for the relay's first line after a log-in; a relay that exceeds it hangs, and another
# cell may serve the robot.
RELAY_ANSWERS_WITHIN_S = 5.0
LOGGED_IN_CHECK_EVERY_S = 0.2


Report = Callable[[Session], Coroutine[Any, Any, None]]

log = logging.getLogger(__name__)


class PacedStreams(Protocol):
    """What sends its streams as fast as a connection takes them."""

    def use(self, connection: socket.socket) -> None:
        """Pace by this connection from now on."""

    def hold(self) -> None:
        """Send nothing until the next `use`: the connection ends."""


@dataclass(frozen=True, kw_only=True)
class Role:
    """What a connection of one kind is for."""

    kind: Kind
    # Where the forward leads now, if anywhere.
    target: Callable[[], ServiceAddress | None]
    # Set when the forward may lead somewhere else now.
    moved: asyncio.Event = field(default_factory=asyncio.Event)
    # Called when the forward is up, for the first time and after each change.
    on_up: Callable[[SshAddress, SessionConfig, Session], None] = lambda *_: None
    # Reports to the server how the robot is, for as long as the connection lasts; on the session only.
    reports: Sequence[Report] = ()
    # Set when the server's own view of the forwards may be another one; on the session only.
    recheck: asyncio.Event | None = None
    # What paces the streams on this connection by how it does; on the media one only.
    video_proxy: PacedStreams | None = None
    # What stops the robot, joined to the session only; None is a bare forward.
    guard: DriveMessageHandler | None = None
    # Called with each configuration; on the session only.
    on_config: Callable[[SessionConfig], None] | None = None
    # The addresses of the other cells, where the server may answer when this one falls silent.
    elsewhere: Callable[[], Sequence[SshAddress]] = lambda: ()
    # Whether somebody drives now, which another network must not end.
    is_driven: Callable[[], bool] = lambda: False


async def run_connection(target: SshAddress, files: SshFiles, role: Role) -> NoReturn:
    """Connect, keep the forward, and serve the session until an AgentError is raised."""
    tunnel = await Tunnel.open(target, files, role.kind)
    try:
        if role.video_proxy is not None:
            role.video_proxy.use(tunnel.socket)
        session = Session(
            tunnel.lines_in, tunnel.lines_out, drive_handler=role.guard, on_config=role.on_config
        )
        await first_of(*_work(tunnel, session, role, target))
        raise await tunnel.why_ended(was_connected=session.config is not None)
    finally:
        if role.video_proxy is not None:
            role.video_proxy.hold()
        await tunnel.close()


def _work(
    tunnel: Tunnel, session: Session, role: Role, target: SshAddress
) -> list[Coroutine[Any, Any, None]]:
    work = [
        _run_session(session, role.guard),
        _keep_forward(tunnel, session, role, target),
        liveness.watch(session, tunnel, target, role.elsewhere, role.is_driven),
        _leave_silent_relay(tunnel, session, role, target),
        *(report(session) for report in role.reports),
    ]
    if role.recheck is not None:
        work.append(_ask_for_checks(session, role.recheck))
    return work


async def _run_session(session: Session, guard: DriveMessageHandler | None) -> None:
    try:
        await session.run()
    finally:
        if guard is not None:
            # At once: the other work and the client may take seconds to end.
            guard.on_session_lost()


async def _leave_silent_relay(
    tunnel: Tunnel, session: Session, role: Role, target: SshAddress
) -> None:
    """Raise ServerSilentError when the cell has accepted the key, sends no configuration, and is not the only one."""
    while not tunnel.is_logged_in:  # noqa: ASYNC110 (the client tells it by a file alone)
        await asyncio.sleep(LOGGED_IN_CHECK_EVERY_S)
    await asyncio.sleep(RELAY_ANSWERS_WITHIN_S)
    if session.config is None and role.elsewhere():
        raise ServerSilentError(f"cannot open the session at {target}: its relay does not answer")
    await asyncio.Event().wait()


async def _keep_forward(tunnel: Tunnel, session: Session, role: Role, target: SshAddress) -> None:
    """Make the live connection's forward follow the configuration, and the guard's port."""
    open_now: Forward | None = None
    reported: tuple[SessionConfig, Forward | None] | None = None
    config = await session.new_config(None)
    tunnel.on_connected()
    while True:
        role.moved.clear()
        forward = _forward(role, config)
        if forward != open_now:
            if open_now is not None:
                await tunnel.cancel(open_now)
            if forward is not None:
                await tunnel.add(forward)
                _log_forward(config, forward)
        open_now = forward
        if reported != (config, forward):
            role.on_up(target, config, session)
            reported = (config, forward)
        await first_of(session.new_config(config), role.moved.wait())
        config = session.config or config


def _forward(role: Role, config: SessionConfig) -> Forward | None:
    listen_port, target = config.ports[BY_CONNECTION[role.kind].name], role.target()
    return None if listen_port is None or target is None else Forward(listen_port, *target)


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
    # What was set before this session has a forward would use its first check up.
    recheck.clear()
    await recheck.wait()
    while True:
        recheck.clear()
        session.send({"type": "check"})
        await asyncio.sleep(CHECK_PAUSE_S)
        every_s = IDLE_CHECK_EVERY_S if session.idle_delay_s else CHECK_EVERY_S
        with suppress(asyncio.TimeoutError):
            await within(every_s - CHECK_PAUSE_S, recheck.wait())
