"""The agent's main loop: identity, enrolment, connections and status.

Started by the cli's `run`. Ends only on a problem that no retry mends, or when it is cancelled; the guard then
stops the robot first, and no process, no control socket and no half-written file is left behind.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from random import Random
from typing import Any

from robotether_agent import __version__
from robotether_agent.backoff import Backoff, Uptime, keep_going
from robotether_agent.battery import Vitals
from robotether_agent.clock import EpochClock
from robotether_agent.connections import (
    LOCALHOST,
    RequestedConnection,
    serve_shell,
    serve_video,
)
from robotether_agent.enrolment.enroller import Enroller
from robotether_agent.files import LOCK, ensure_directory, only_one
from robotether_agent.guard.fork_server import ForkServer, fork_server_command
from robotether_agent.guard.supervisor import GuardSupervisor, GuardView
from robotether_agent.health import Health
from robotether_agent.help.caller import HelpCaller
from robotether_agent.net.server_dialer import SshAddress
from robotether_agent.problems import (
    AgentError,
    KeyRefusedError,
    ServerBusyError,
    ServerKeyChangedError,
    ServerUnreachableError,
    StateUnusableError,
)
from robotether_agent.rosbridge import RosGraph
from robotether_agent.settings import Settings
from robotether_agent.status import CONNECTED, StatusWriter
from robotether_agent.systemd import Notifier
from robotether_agent.tasks import first_of, within
from robotether_agent.tunnel.audit_heads import sign_heads
from robotether_agent.tunnel.connection import Report, Role
from robotether_agent.tunnel.connector import Connector
from robotether_agent.tunnel.openssh import ServiceAddress, target_of
from robotether_agent.tunnel.session import (
    UNCHECKED,
    Checked,
    RequestedFeatures,
    Session,
    SessionConfig,
)
from robotether_agent.video.sources import SourceSettings

STATUS_EVERY_S = 2.0

log = logging.getLogger(__name__)


class Agent:
    """One robot's agent; make it, then await run().

    `fork_server` forks its guards; without it the first one waits until a program has started that does.
    """

    def __init__(
        self,
        settings: Settings,
        notifier: Notifier,
        rng: Random,
        fork_server: ForkServer | None = None,
    ) -> None:
        self._settings = settings
        self._fork_server = fork_server
        self._notifier = notifier
        self._rng = rng
        self._enroller = Enroller(settings)
        self._epochs = EpochClock()
        self._connector = Connector(settings, self._enroller)
        self._graph = RosGraph(settings.rosbridge_url)
        self._vitals = Vitals(self._graph, settings.state_dir)
        source_settings = SourceSettings(
            settings.video_url,
            settings.rosbridge_url,
            settings.video_source,
            settings.camera_urls,
        )
        self._health = Health(source_settings, self._graph)
        self._help = HelpCaller(self._graph, self._stop_state, lambda: self._vitals.battery)
        self._status_writer = StatusWriter(
            settings.run_dir, settings.server, on_state=notifier.status
        )
        self._session: Session | None = None
        self._session_up = asyncio.Event()
        # For those that wait for one more session: set, and another one in its place, whenever one is up.
        self._next_session = asyncio.Event()
        self._features = RequestedFeatures(allows_shell=bool(settings.shell_address))
        self._recheck = asyncio.Event()
        self._guard_moved = asyncio.Event()
        self._guard = self._supervisor() if settings.guard == "on" else None
        self._beside = self._connections_beside(source_settings)

    def _connections_beside(
        self, source_settings: SourceSettings
    ) -> tuple[RequestedConnection, ...]:
        """Return what stays connected beside the session, while the server requests it."""
        settings = self._settings
        row = partial(
            RequestedConnection,
            connect=self._connect,
            status_writer=self._status_writer,
            session_up=self._session_up,
            recheck=self._recheck,
        )
        return (
            row(
                kind="media",
                request=self._features.media,
                serve=partial(
                    serve_video,
                    settings,
                    source_settings,
                    self._graph,
                    self._has_video,
                    on_frame_sent=self._on_frame_sent,
                    on_encoders=lambda text: self._status_writer.set(encoder=text),
                ),
                bye="unwatched",
                reason="nobody watches its video any more",
                idle="unwatched",
            ),
            row(
                kind="shell",
                request=self._features.shell,
                serve=partial(serve_shell, settings),
                bye="shell_off",
                reason="the server has turned the shell off",
                idle="off",
            ),
        )

    async def run(self) -> None:
        """Keep the robot connected."""
        ensure_directory(self._settings.run_dir, "run_dir")
        with only_one(self._settings.run_dir / LOCK):
            self._status_writer.refresh()
            log.info("robotether-agent %s serves %s", __version__, self._settings.server)
            # Ready means running, not connected: the boot must not wait for a server that is down.
            self._notifier.ready()
            try:
                # In this order: the guard stops the robot while its tunnels are still up.
                await first_of(self._keep_guard(), first_of(*self._work()), in_order=True)
            except AgentError as problem:
                self._status_writer.report_problem(problem, "stopped")
                if isinstance(problem, ServerKeyChangedError):
                    await self._enroller.report_host_key()
                raise
            finally:
                self._status_writer.set(
                    state="stopped",
                    rtt_ms=-1.0,
                    video_tunnel="closed",
                    shell_tunnel="off",
                    guard="off" if self._guard is None else "down",
                )
                await self._graph.close()

    def _supervisor(self) -> GuardSupervisor:
        ours = self._settings
        command = fork_server_command(ours.state_dir, ours.run_dir, ours.log_level)
        return GuardSupervisor(
            ours.rosbridge_url,
            command,
            fork_server=self._fork_server,
            on_change=self._show_guard,
        )

    async def _keep_guard(self) -> None:
        if self._guard is None:
            log.warning("the guard is off: nothing stops this robot when commands stop")
            self._status_writer.set(guard="off")
            await asyncio.Event().wait()
        else:
            with suppress(StateUnusableError):
                # The session's attempts report it; a robot in motion needs its guard all the same.
                ensure_directory(self._settings.state_dir, "state_dir", 0o700)
            await self._guard.run()

    def _work(self) -> list[Coroutine[Any, Any, None]]:
        def keep(
            what: str,
            attempt: Callable[[Uptime], Awaitable[None]],
            on_problem: Callable[[AgentError], None],
            pause: Callable[[float], Awaitable[None]] = asyncio.sleep,
        ) -> Coroutine[Any, Any, None]:
            return keep_going(what, attempt, Backoff(self._rng), on_problem, pause)

        return [
            keep("session", self._session_attempt, self._no_session),
            *(
                keep(
                    f"{connection.service} tunnel",
                    connection.attempt,
                    connection.on_problem,
                    self._until_next_session,
                )
                for connection in self._beside
            ),
            keep("new key", self._rotation_attempt, self._no_rotation),
            self._health.run(),
            self._help.watch(),
            self._show_health(),
            self._refresh_status(),
            self._notifier.keep_watchdog(),
        ]

    async def _session_attempt(self, uptime: Uptime) -> None:
        await self._show_key()
        self._show_identity()
        enrolment = await self._enroller.enrolment()
        self._status_writer.set(state="connecting", robot=enrolment.robot)
        role = Role(
            kind="session",
            target=self._ros_target,
            moved=self._guard_moved,
            on_up=partial(self._session_is_up, uptime),
            reports=self._reporters(),
            recheck=self._recheck,
            guard=self._guard,
            on_config=self._on_config,
            is_driven=self._is_driven,
        )
        try:
            await self._connector.connect(enrolment, await self._enroller.key(), role)
        except KeyRefusedError:
            # Only the join says why: not approved yet, disabled, or another key in this robot's place.
            self._enroller.doubt()
            await self._enroller.enrolment()
            raise
        except ServerBusyError:
            # That is the server. Whole fleets that also ask the web now are what would keep it busy.
            raise
        except (ServerUnreachableError, ServerKeyChangedError):
            self._enroller.doubt_address()
            raise
        finally:
            uptime.was_used = self._session is not None and self._session.is_used
            self._session = None
            self._session_up.clear()
            self._status_writer.set(**_seen_from_server(UNCHECKED))

    async def _until_next_session(self, most_s: float) -> None:
        """Wait; a server that takes the robot's session again takes what goes beside it, too."""
        with suppress(asyncio.TimeoutError):
            await within(most_s, self._next_session.wait())

    def _on_frame_sent(self, camera: str, frame: int, taken_s: float) -> None:
        if self._guard is not None:
            self._guard.on_frame_sent(camera, frame, taken_s)

    def _on_config(self, config: SessionConfig) -> None:
        self._features.apply(config)
        self._help.use(config.help)

    def _stop_state(self) -> tuple[bool | None, str]:
        """Return whether the guard keeps the robot stopped, and for whom; None: there is none that says so."""
        if self._guard is None or self._guard.view.state != "ready":
            return None, ""
        return self._guard.view.stopped, self._guard.view.by

    def _has_video(self) -> bool:
        return self._health.report.video == "ok"

    def _reporters(self) -> list[Report]:
        reporters: list[Report] = [
            partial(report_health, self._health, self._guard, self._epochs),
            partial(report_vitals, self._vitals),
            partial(ask_for_help, self._help),
            partial(report_position, self._help),
            self._connector.ask_for_nearer,
            partial(follow_drive_topic, self._graph),
            partial(sign_heads, self._settings.state_dir, self._enroller.key),
        ]
        if self._guard is not None:
            reporters.append(partial(report_guard, self._guard))
        return reporters

    def _ros_target(self) -> ServiceAddress | None:
        """Return where the guard listens, which is nowhere while there is no guard."""
        if self._guard is None:
            return target_of(self._settings.rosbridge_url)
        port = self._guard.view.port
        return None if port is None else ServiceAddress(LOCALHOST, port)

    async def _rotation_attempt(self, _: Uptime) -> None:
        await self._features.new_key.wait()
        request = self._features.new_key.number
        await self._enroller.rotate()
        self._features.new_key.end(request)
        self._status_writer.set(new_key="")
        await self._show_key()

    async def _connect(self, role: Role) -> None:
        enrolment = await self._enroller.enrolment()
        role = replace(role, is_driven=self._is_driven)
        await self._connector.connect(enrolment, await self._enroller.key(), role)

    def _is_driven(self) -> bool:
        return self._guard is not None and self._guard.is_driven()

    async def _show_key(self) -> None:
        """Show the key that an admin compares with what the server got."""
        key = await self._enroller.key()
        newest_key = await self._enroller.next_key() or key
        self._status_writer.set(fingerprint=newest_key.fingerprint)

    def _show_identity(self) -> None:
        identity = self._enroller.identity()
        has_it = identity.interface or "by the settings"
        self._status_writer.set(mac=identity.mac, interface=has_it if identity.is_present else "")

    def _session_is_up(
        self, uptime: Uptime, target: SshAddress, config: SessionConfig, session: Session
    ) -> None:
        uptime.is_up()
        is_new = self._session is not session
        self._session = session
        self._session_up.set()
        self._next_session.set()
        self._next_session = asyncio.Event()
        if not self._features.new_key.is_set():
            # It may have come with a join, and not by the attempt that failed.
            self._status_writer.set(new_key="")
        self._recheck.set()
        self._status_writer.set(
            state=CONNECTED,
            robot=config.robot,
            ssh=str(target),
        )
        for connection in self._beside:
            self._status_writer.set(**connection.status())
        if not is_new:
            # Other settings, or another port of the guard.
            return
        # By the words of sshd's log; an address translation on the way changes both.
        named = f", which logs it as {config.connection_id}" if config.connection_id else ""
        log.info("robot %s: connected to %s%s", config.robot, target, named)

    def _no_session(self, problem: AgentError) -> None:
        is_pending = problem.code == "not_enrolled"
        self._status_writer.report_problem(
            problem, "pending" if is_pending else "waiting", rtt_ms=-1.0
        )

    def _no_rotation(self, problem: AgentError) -> None:
        self._status_writer.set(new_key=str(problem))

    def _show_guard(self, view: GuardView) -> None:
        self._guard_moved.set()
        stopped_by = (view.by or "somebody") if view.stopped else ""
        self._status_writer.set(guard=view.state, guard_detail=view.detail, stopped_by=stopped_by)

    async def _show_health(self) -> None:
        report = self._health.report
        while True:
            report = await self._health.changed(report)
            self._status_writer.set(**asdict(report))
            # What the server saw of a service that was down, or has gone down since, is no longer true.
            self._recheck.set()

    async def _refresh_status(self) -> None:
        while True:
            session = self._session
            rtt_ms = None if session is None else session.rtt_ms
            seen = {} if session is None else _seen_from_server(session.checked)
            self._status_writer.set(rtt_ms=-1.0 if rtt_ms is None else rtt_ms, **seen)
            await asyncio.sleep(STATUS_EVERY_S)


def _seen_from_server(checked: Checked) -> dict[str, str]:
    return {f"end_to_end_{name}": state for name, state in checked.items()}


async def report_health(
    health: Health, guard: GuardSupervisor | None, epochs: EpochClock, session: Session
) -> None:
    """Report to the server who this is, and how the robot's services are at each change."""
    who = {"hostname": socket.gethostname(), "agent_version": __version__}
    mode = "off" if guard is None else "on"
    session.send({"type": "hello", **who, "guard": mode, "epoch": epochs.next()})
    await session.new_config(None)
    report = health.report
    while True:
        session.send(
            {
                "type": "health",
                "ros": report.ros,
                "video": report.video,
                "detail": report.detail,
                "ros_exposed": bool(report.ros_exposed),
            }
        )
        report = await health.changed(report)


async def report_vitals(vitals: Vitals, session: Session) -> None:
    """Pass on how the robot itself is."""
    first = await session.new_config(None)
    await vitals.report(session.send, lambda: (session.config or first).battery)


async def ask_for_help(caller: HelpCaller, session: Session) -> None:
    """Pass on the robot's calls for help."""
    await session.new_config(None)
    await caller.report(session.send, session.until_read)


async def report_position(caller: HelpCaller, session: Session) -> None:
    """Report where the robot is, if that is known."""
    await session.new_config(None)
    await caller.report_position(session.send, lambda: session.is_used)


async def follow_drive_topic(graph: RosGraph, session: Session) -> None:
    """Let the graph know by which topic the server drives this robot."""
    config = None
    while True:
        config = await session.new_config(config)
        graph.drive_topic = config.battery.drive_topic


async def report_guard(guard: GuardSupervisor, session: Session) -> None:
    """Pass on what the guard says."""
    await session.new_config(None)
    with guard.following() as lines:
        while True:
            session.send(await lines.get())
