"""One TCP connection of a robot: takes over, configures, keeps the heartbeat, and ends.

`session_server` makes one for each accepted connection. When it ends, sshd's session command ends
the SSH connection that it belongs to, which releases the robot's ports. It must never wait for a
robot that does not read.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections.abc import Awaitable, Callable, Iterable, Sequence
from dataclasses import dataclass

from robotether_common.session import ByeCode, HelpCall

from robotether_server.db.cells import SshAddresses
from robotether_server.db.fleet import RelayRobot
from robotether_server.problems import ProtocolError
from robotether_server.relay.http.timing import STALLED_S, RateLimiter, RobotClock
from robotether_server.relay.robots import session_messages as lines
from robotether_server.relay.robots.authorization import needs_config, port_of
from robotether_server.relay.robots.port_checks import LinkChecks, PortChecker, wait_released
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.session_messages import Preface
from robotether_server.settings.server import RelaySettings

log = logging.getLogger(__name__)

# Maximum unsent size; beyond it the other side has stopped reading.
MAX_UNSENT_BYTES = 256 * 1024
# Maximum number of unanswered heartbeats; the time limit ends the link well before.
MAX_PINGS_OPEN = 64
# Number of an idle robot's heartbeats per measurement of the round trip, which is only displayed.
IDLE_PING_EACH = 5
# Maximum rate of lines; an agent sends some three a second, and reading without a limit would
# starve the others.
LINES_PER_S = 200
LINES_AT_ONCE = 400
GUARD_KEY_BYTES = 32
# Time limit for sending a bye.
FAREWELL_S = 0.5
# Time limit for the end of the connection that held the robot's port before.
PORT_RELEASED_WITHIN_S = 1.0


@dataclass(frozen=True)
class HeartbeatTimes:
    """How often a robot and the relay send heartbeats, and after how long without any the connection is over."""

    heartbeat_s: float = 0.5
    # For a robot that nobody uses.
    idle_heartbeat_s: float = 2.0
    timeout_s: float = 5.0


@dataclass(frozen=True)
class LinkRules:
    """What is the same for all links of a relay.

    `greeting` gives what a robot is sent after its configuration: its lease, and whether it is stopped. `prepare` comes
    before, and reads what other cells wrote of the robot. `cells` gives where it connects. `on_help` is called when a
    robot asks for a person, `on_nearer` when it asks for a move to another cell, `on_signed_head` when it has signed a
    line of the audit log.
    """

    settings: RelaySettings
    times: HeartbeatTimes
    greeting: Callable[[int], Iterable[bytes]]
    cells: Callable[[int], Sequence[SshAddresses]]
    prepare: Callable[[int], Awaitable[None]]
    on_help: Callable[[int, HelpCall], None]
    on_nearer: Callable[[int, SshAddresses], None]
    on_signed_head: Callable[[int, lines.SignedHeadLine], None]


class RobotLink:
    """A robot's connection of one kind, from its preface on."""

    def __init__(
        self,
        preface: Preface,
        robot: RelayRobot,
        *,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        registry: SessionRegistry,
        rules: LinkRules,
        checker: PortChecker,
    ) -> None:
        self.preface = preface
        self.robot_id, self.kind, self.address = preface.robot_id, preface.kind, preface.address
        self._robot = robot
        self._reader = reader
        self._writer = writer
        self.guard_key = secrets.token_urlsafe(GUARD_KEY_BYTES)
        self.clock = RobotClock()
        self._registry = registry
        self._rules = rules
        self._checker = checker
        self._checks = LinkChecks(self._check)
        self._loop = asyncio.get_running_loop()
        self._received_at = self._loop.time()
        self._heartbeats = 0
        self._seq = 0
        self._pings: dict[int, float] = {}
        self._heartbeat_timer: asyncio.TimerHandle | None = None
        self._farewell: asyncio.TimerHandle | None = None
        # Not before the older link is gone: the agent opens its forwards on the configuration.
        self._configured = False
        self._idle_heartbeat_s: float | None = None
        self._cells: Sequence[SshAddresses] = ()
        # Set by the answer to a ping that follows the newest configuration, if that has quick heartbeats.
        self._quick = asyncio.Event()
        self._quick_from = 0
        self._guard_reported = asyncio.Event()
        self._ended = False

    async def run(self) -> None:
        """Take over from an older link, configure the robot, and listen until the end."""
        try:
            await self._replace_older()
            if self.kind == "session":
                await self._rules.prepare(self.robot_id)
            if not self._ended and not self._reader.at_eof():
                self._configure()
                self._greet()
                self._registry.established(self)
                self._heartbeat()
                await self._listen()
        except ProtocolError as exc:
            log.warning("robot %s: %s broke the protocol: %s", self._robot.name, self.kind, exc)
            self.end("protocol_error", str(exc))
        except ConnectionError as exc:
            log.info("robot %s: %s broke: %s", self._robot.name, self.kind, exc)
        finally:
            self._close("link_lost")
            await self._checks.close()
            await self._closed()

    def send(self, line: bytes) -> None:
        """Send a line to the agent, if the link still is."""
        if self._ended or self._writer.is_closing():
            return
        self._writer.write(line)
        if self._writer.transport.get_write_buffer_size() > MAX_UNSENT_BYTES:
            self.end("timeout", "the robot does not read what the relay sends")

    def end(self, code: ByeCode, detail: str) -> None:
        """Say bye and close at once; the robot's ports are free as soon as sshd sees it."""
        if self._ended:
            return
        log.info("robot %s: %s ends: %s: %s", self._robot.name, self.kind, code, detail)
        if not self._writer.is_closing():
            self._writer.write(lines.bye_line(code, detail))
        self._close(code)

    def reconfigure(self, robot: RelayRobot) -> None:
        """Use the robot's new row: send what is new; NotAuthorizedError when that needs a new SSH login."""
        if self._ended or robot == self._robot:
            return
        before, self._robot = self._robot, robot
        if needs_config(before, robot) and self._configured:
            self._configure()
        else:
            # The robot may have another region.
            self.on_cells()

    def on_media_demand(self) -> None:
        """Have the agent open the media connection for viewers, or end it when there are none."""
        if self.kind == "session" and self._configured:
            self._configure()
        elif self.kind == "media" and not self._needs_media:
            self.end("unwatched", f"nobody watches robot {self._robot.name}")

    def on_usage(self) -> None:
        """Have quick heartbeats both ways, from now on, while somebody uses the robot."""
        if self._configured:
            self._quick.clear()
            self._quick_from = self._seq + 1
            self._configure()
            self._heartbeat()

    def on_cells(self) -> None:
        """Send where the robot connects, if that has changed."""
        if self._configured and self._cells != self._cells_now():
            self._configure()

    def send_cells(self, cells: Sequence[SshAddresses]) -> None:
        """Send where the robot connects next, the best first."""
        if self._configured:
            self._configure(cells)

    async def until_quick(self) -> None:
        """Wait until the agent has read that heartbeats are quick, as they are while somebody uses the robot."""
        await self._quick.wait()

    async def until_guard_reported(self) -> None:
        """Wait until the robot's guard has reported on this link, or the agent that there is none."""
        await self._guard_reported.wait()

    @property
    def _needs_media(self) -> bool:
        return self._registry.robot(self.robot_id).media_demand.exists

    async def _replace_older(self) -> None:
        """End the older link, and this one too if somebody else still holds the robot's port."""
        older = self._registry.make_current(self)
        if older is not None:
            older.end("superseded", f"a newer {self.kind} of robot {self._robot.name} took over")
        port = port_of(self.kind, self._robot)
        host = self._rules.settings.tunnel_host
        if port is not None and not await wait_released(
            host, port, within_s=PORT_RELEASED_WITHIN_S
        ):
            # It would be that holder who gets the operators: an SSH connection without a session,
            # which the relay cannot end. sshd drops it when it is dead.
            self.end(
                "port_taken",
                f"port {port} is still in use after {PORT_RELEASED_WITHIN_S:g} s; connect again",
            )

    def _configure(self, cells: Sequence[SshAddresses] | None = None) -> None:
        rules, self._configured = self._rules, True
        is_used = self._registry.robot(self.robot_id).usage.exists
        self._idle_heartbeat_s = None if is_used else rules.times.idle_heartbeat_s
        self._cells = self._cells_now() if cells is None else cells
        self.send(
            lines.config_line(
                self._robot,
                heartbeat_s=rules.times.heartbeat_s,
                idle_heartbeat_s=self._idle_heartbeat_s,
                timeout_s=rules.times.timeout_s,
                guard_key=self.guard_key,
                direct=rules.settings.direct,
                media=self._needs_media,
                cells=self._cells,
                connection_id=self.preface.connection_id,
            )
        )

    def _cells_now(self) -> Sequence[SshAddresses]:
        """Where the robot connects; its other connections follow its session."""
        return self._rules.cells(self.robot_id) if self.kind == "session" else ()

    def _greet(self) -> None:
        if self.kind == "session":
            for line in self._rules.greeting(self.robot_id):
                self.send(line)

    async def _listen(self) -> None:
        self._received_at = self._loop.time()
        limiter = RateLimiter(self._received_at, per_s=LINES_PER_S, at_once=LINES_AT_ONCE)
        while not self._ended:
            try:
                line = await self._reader.readline()
            except ValueError as exc:
                raise ProtocolError("cannot read a line: it is over 64 KiB") from exc
            if not line.endswith(b"\n"):
                return
            self._received_at = self._loop.time()
            if not limiter.allow(self._received_at):
                raise ProtocolError(f"cannot continue: more than {LINES_PER_S} lines a second")
            if (message := lines.parse_line(line)) is not None:
                self._handle(message)

    def _handle(self, message: lines.Line) -> None:
        match message:
            case lines.PingLine():
                self.clock.on_ping(time.monotonic(), message.t_ms)
                self.send(lines.pong_line(message))
            case lines.PongLine():
                self._on_pong(message.seq)
            case lines.HelloLine():
                self._registry.on_hello(
                    self, message.agent_version, message.guard, epoch=message.epoch
                )
                if message.guard == "off":
                    self._guard_reported.set()
            case lines.GuardLine():
                self._registry.on_guard_status(self, message.report, message.answers)
                self._guard_reported.set()
            case lines.SeenReport():
                self._registry.on_seen(self, message)
            case lines.HealthLine(ros, video, ros_exposed):
                self._registry.on_health(self, ros, video, ros_exposed=ros_exposed)
            case lines.VitalsLine():
                self._registry.on_battery(self, message.rounded)
            case _:
                self._handle_request(message)

    def _handle_request(self, message: lines.Line) -> None:
        if self._registry.session_of(self.robot_id) is not self:
            return
        match message:
            case lines.HelpLine():
                self._rules.on_help(self.robot_id, message.call)
            case lines.NearerLine(host, ports):
                self._rules.on_nearer(self.robot_id, SshAddresses(host, ports))
            case lines.PositionLine():
                self._registry.robot(self.robot_id).on_position(message.position)
            case lines.SignedHeadLine():
                self._rules.on_signed_head(self.robot_id, message)
            case lines.CheckLine():
                self._checks.ask()

    async def _check(self) -> None:
        health = await self._checker.check(self._robot, video=self._needs_media)
        self.send(lines.checked_line(health))

    def _on_pong(self, seq: int) -> None:
        sent_at = self._pings.pop(seq, None)
        if sent_at is not None:
            if self._idle_heartbeat_s is None and seq >= self._quick_from:
                self._quick.set()
            self._registry.on_heartbeat(self, (self._loop.time() - sent_at) * 1000)

    def _heartbeat(self) -> None:
        if self._ended:
            return
        times, now = self._rules.times, self._loop.time()
        if self._heartbeat_timer is not None:
            if now - self._heartbeat_timer.when() > STALLED_S:
                self._received_at = now
            self._heartbeat_timer.cancel()
        left_s = self._received_at + times.timeout_s - now
        if left_s < 0:
            self.end("timeout", f"nothing came for {times.timeout_s:g} s")
            return
        if self.kind == "session" and (
            self._idle_heartbeat_s is None or self._heartbeats % IDLE_PING_EACH == 0
        ):
            self._ping(now)
        self._heartbeats += 1
        # An idle robot that falls silent is noticed as early as one in use.
        idle_s = min(self._idle_heartbeat_s or 0, left_s)
        self._heartbeat_timer = self._loop.call_later(
            max(times.heartbeat_s, idle_s), self._heartbeat
        )

    def _ping(self, now: float) -> None:
        """Measure the round trip; that a link of any kind is alive, the agent's own pings show."""
        self._seq += 1
        self._pings[self._seq] = now
        self._pings.pop(self._seq - MAX_PINGS_OPEN, None)
        self.send(lines.ping_line(self._seq))

    def _close(self, code: ByeCode) -> None:
        if self._ended:
            return
        self._ended = True
        if self._heartbeat_timer is not None:
            self._heartbeat_timer.cancel()
        self._registry.disconnected(self, code)
        self._writer.close()
        # A peer that does not read would keep a closing connection, and so its port, for ever.
        self._farewell = self._loop.call_later(FAREWELL_S, self._writer.transport.abort)

    async def _closed(self) -> None:
        """Wait until the farewell is sent, or cut short."""
        try:
            await self._writer.wait_closed()
        except ConnectionError:
            log.debug("robot %s: %s was reset", self._robot.name, self.kind)
        finally:
            if self._farewell is not None:
                self._farewell.cancel()
