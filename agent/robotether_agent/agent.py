"""The agent's main loop: who this robot is, its place on the server, its two connections, its status.

Started by the cli's `run`. Ends only on a problem that no retry mends, or when it is cancelled; it then
leaves no SSH client, no control socket and no half-written file behind.
"""

from __future__ import annotations

import asyncio
import logging
from functools import partial
from random import Random

from robotether_agent import __version__
from robotether_agent.backoff import Backoff
from robotether_agent.connection import Role, run_connection
from robotether_agent.enroller import Enroller
from robotether_agent.enrolment import Enrolment
from robotether_agent.files import LOCK, ensure_directory, only_one
from robotether_agent.health import Health
from robotether_agent.keys import KeyPair
from robotether_agent.notify import Notifier
from robotether_agent.problems import KeyRefused, Problem, ServerUnreachable
from robotether_agent.session import Config, Session
from robotether_agent.settings import Settings
from robotether_agent.ssh_command import SshFiles, Target, forward_to
from robotether_agent.status import CONNECTED, StatusBoard
from robotether_agent.supervisor import Uptime, keep_going
from robotether_agent.tasks import first_of

STATUS_EVERY_S = 2.0

log = logging.getLogger(__name__)


class Agent:
    """One robot's agent; make it, then await run()."""

    def __init__(self, settings: Settings, notifier: Notifier, rng: Random) -> None:
        self._settings = settings
        self._notifier = notifier
        self._rng = rng
        self._enroller = Enroller(settings)
        self._health = Health(settings.rosbridge_url, settings.video_url)
        self._board = StatusBoard(settings.run_dir, settings.server, on_state=notifier.status)
        self._session: Session | None = None
        self._session_up = asyncio.Event()
        # The port that worked last comes first: on many networks only one of them is let out.
        self._good_port: int | None = None

    async def run(self) -> None:
        """Keep the robot connected."""
        ensure_directory(self._settings.run_dir, "run_dir")
        with only_one(self._settings.run_dir / LOCK):
            self._board.refresh()
            log.info("robotether-agent %s serves %s", __version__, self._settings.server)
            # Ready means running, not connected: the boot must not wait for a server that is down.
            self._notifier.ready()
            try:
                await first_of(
                    keep_going("session", self._session_attempt, self._backoff(), self._no_session),
                    keep_going(
                        "video tunnel", self._media_attempt, self._backoff(), self._no_media
                    ),
                    self._health.run(),
                    self._show_health(),
                    self._refresh_status(),
                    self._notifier.keep_watchdog(),
                )
            except Problem as problem:
                self._board.tell(problem, "stopped")
                raise
            finally:
                self._notifier.stopping()
                self._board.set(state="stopped", rtt_ms=-1.0, video_tunnel="closed")

    def _backoff(self) -> Backoff:
        return Backoff(self._rng)

    async def _session_attempt(self, uptime: Uptime) -> None:
        key = await self._enroller.key()
        shown = await self._enroller.next_key() or key
        # While the robot waits for its approval, the admin compares this with what the server got.
        self._board.set(fingerprint=shown.fingerprint)
        enrolment = await self._enroller.enrolment(key)
        self._board.set(state="connecting", robot=enrolment.robot)
        role = Role(
            kind="session",
            forward=lambda config: forward_to(self._settings.rosbridge_url, config.ros_port),
            on_up=partial(self._session_is_up, uptime),
            health=self._health,
        )
        try:
            await self._connect(enrolment, key, role)
        except KeyRefused:
            # Only the join tells why: not approved yet, disabled, or another key in this robot's place.
            self._enroller.doubt()
            await self._enroller.enrolment(key)
            raise
        except ServerUnreachable:
            self._enroller.doubt()
            raise
        finally:
            self._session = None
            self._session_up.clear()

    async def _media_attempt(self, uptime: Uptime) -> None:
        await self._session_up.wait()
        key = await self._enroller.key()
        role = Role(
            kind="media",
            forward=lambda config: forward_to(self._settings.video_url, config.video_port),
            on_up=partial(self._media_is_up, uptime),
        )
        await self._connect(await self._enroller.enrolment(key), key, role)

    async def _connect(self, enrolment: Enrolment, key: KeyPair, role: Role) -> None:
        """Try the server's ports in order, until one answers; raise what ended the connection."""
        unreachable = [
            await self._unless_unreachable(target, key, role) for target in self._targets(enrolment)
        ]
        raise ServerUnreachable(
            "; ".join(problem.message for problem in unreachable), advice=unreachable[0].advice
        )

    async def _unless_unreachable(
        self, target: Target, key: KeyPair, role: Role
    ) -> ServerUnreachable:
        """Connect to `target`; return only if nothing answers there."""
        control = self._settings.run_dir / f"{role.kind}.ctl"
        files = SshFiles(key.path, self._enroller.known_hosts, control)
        try:
            await run_connection(target, files, role)
        except ServerUnreachable as problem:
            return problem

    def _targets(self, enrolment: Enrolment) -> list[Target]:
        settings, ssh = self._settings, enrolment.ssh
        host = settings.ssh_host or ssh.host or settings.server_host
        ports = settings.ssh_ports or ssh.ports
        in_order = sorted(ports, key=lambda port: port != self._good_port)
        return [Target(host, port, ssh.user) for port in in_order]

    def _session_is_up(
        self, uptime: Uptime, target: Target, config: Config, session: Session
    ) -> None:
        uptime.is_up()
        self._good_port = target.port
        self._session = session
        self._session_up.set()
        self._board.set(state=CONNECTED, robot=config.robot)
        log.info("robot %s: connected to %s", config.robot, target)

    def _media_is_up(self, uptime: Uptime, _: Target, config: Config, __: Session) -> None:
        uptime.is_up()
        self._board.set(video_tunnel="open")
        log.info("robot %s: video tunnel open", config.robot)

    def _no_session(self, problem: Problem) -> None:
        pending = problem.code == "not_enrolled"
        self._board.tell(problem, "pending" if pending else "waiting", rtt_ms=-1.0)

    def _no_media(self, problem: Problem) -> None:
        self._board.tell(problem, self._board.status.state, video_tunnel="closed")

    async def _show_health(self) -> None:
        report = self._health.report
        while True:
            report = await self._health.changed(report)
            self._board.set(
                ros=report.ros,
                ros_detail=report.ros_detail,
                video=report.video,
                video_detail=report.video_detail,
            )

    async def _refresh_status(self) -> None:
        while True:
            rtt_ms = None if self._session is None else self._session.rtt_ms
            self._board.set(rtt_ms=-1.0 if rtt_ms is None else rtt_ms)
            await asyncio.sleep(STATUS_EVERY_S)
