"""One connection of a kind, from its SSH client to its forward: session (control), media (video) or shell.

Run by the agent, one of each kind, so that control never waits behind video or a file copy. A connection ends with the
problem that ended it; it never tries again by itself.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Callable, Coroutine, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NoReturn, Protocol

from robotether_agent.net.server_dialer import Target
from robotether_agent.tasks import first_of, within
from robotether_agent.tunnel import liveness
from robotether_agent.tunnel.session import Session, SessionConfig
from robotether_agent.tunnel.session_messages import DriveMessageHandler
from robotether_agent.tunnel.ssh_command import Forward, Kind, SshFiles
from robotether_agent.tunnel.tunnel import Tunnel

# The server answers at most once in 5 s.
CHECK_PAUSE_S = 5.5
CHECK_EVERY_S = 60.0

log = logging.getLogger(__name__)


Report = Callable[[Session], Coroutine[Any, Any, None]]


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
    # Told when the forward stands, for the first time and after each change.
    on_up: Callable[[Target, SessionConfig, Session], None]
    # What tells the server how the robot is, for as long as the connection lasts; on the session only.
    reports: Sequence[Report] = ()
    # Set when the server's own view of the forwards may be another one; on the session only.
    recheck: asyncio.Event | None = None
    # What paces the streams on this connection by how it does; on the media one only.
    video_proxy: PacedStreams | None = None
    # What stops the robot, joined to the session only; None is a bare forward.
    guard: DriveMessageHandler | None = None


async def run_connection(target: Target, files: SshFiles, role: Role) -> NoReturn:
    """Connect, keep the forward, and serve the session until a Problem is raised."""
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
    tunnel: Tunnel, session: Session, role: Role, target: Target
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


async def _keep_forward(tunnel: Tunnel, session: Session, role: Role, target: Target) -> None:
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
    """Ask how the robot looks from the server: when a forward stands, and now and then."""
    await recheck.wait()
    while True:
        recheck.clear()
        session.send({"type": "check"})
        await asyncio.sleep(CHECK_PAUSE_S)
        with suppress(asyncio.TimeoutError):
            await within(CHECK_EVERY_S - CHECK_PAUSE_S, recheck.wait())
