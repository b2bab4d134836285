"""Answers /robots/NAME/ros: authorizes an operator, reaches the robot, and runs a `Bridge`.

What concerns ticket, origin or name is refused over HTTP; browsers cannot read such an answer's
body, so all that concerns the robot is reported after the upgrade, as a close code with a reason.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

from aiohttp import web
from robotether_common.topics import MAX_TOPICS

from robotether_server import __version__
from robotether_server.db.control import DriveEntry
from robotether_server.db.fleet import RECORDER, Credential
from robotether_server.problems import HttpError
from robotether_server.relay.auth.access import HandlerContext, Permit, request_of
from robotether_server.relay.channels.rosbridge.bridge import (
    Bridge,
    OwnOperations,
    RobotEnd,
    Traffic,
)
from robotether_server.relay.channels.rosbridge.drive_path import (
    CommandReport,
    DriveLease,
)
from robotether_server.relay.channels.rosbridge.forwarded_topics import ForwardedTopics, key_of
from robotether_server.relay.channels.rosbridge.message_validator import MessageValidator
from robotether_server.relay.channels.rosbridge.operations import write_json
from robotether_server.relay.channels.rosbridge.shared_topics import (
    MAX_OBSERVED_TOPICS,
    MAX_STANDING_TOPICS,
    SharedTopics,
)
from robotether_server.relay.channels.rosbridge.subscriptions import (
    TopicCopies,
    TopicSharing,
)
from robotether_server.relay.control.control import Control
from robotether_server.relay.control.leasing import now
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.http.sockets import OperatorSocket
from robotether_server.relay.http.timing import LivenessLimits
from robotether_server.relay.robots.connection import Connection
from robotether_server.relay.robots.drive_log import DriveCounters, DriveLog
from robotether_server.relay.robots.lease import Driver
from robotether_server.relay.robots.recorders import Recorders
from robotether_server.relay.robots.session_messages import SeenReport
from robotether_server.times import utc_now

# Maximum size of an observer's message; observers send little, and parsing delays all others.
OBSERVER_LIMIT = 64 * 1024


@dataclass(frozen=True)
class BridgeRules:
    """What is the same for all bridges of a relay."""

    limits: LivenessLimits
    driver_limits: LivenessLimits
    message_limit: int
    traffic: Traffic
    shared_topics: SharedTopics


@dataclass(frozen=True)
class ConnectionReport:
    """What `observers` learns of a connection; ending None: it has reached the robot."""

    connection: Connection
    address: str | None
    close_reason: CloseReason | None = None
    lasted_s: float = 0.0
    drive: DriveLog | None = None
    refused: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class SessionContext:
    """What each connection to a robot's rosbridge needs, an operator's or that of routes."""

    handlers: HandlerContext
    control: Control
    rules: BridgeRules
    report: Callable[[ConnectionReport], None]


@dataclass(frozen=True)
class RosbridgeHandler:
    """Answers /robots/NAME/ros."""

    context: SessionContext

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Join an operator's WebSocket to the robot until one of them ends."""
        if not web.WebSocketResponse().can_prepare(request):
            raise HttpError(426, "cannot open rosbridge: connect with a WebSocket")
        permit = self.context.handlers.access.for_rosbridge(
            request_of(request), request.match_info["name"]
        )
        observes = permit.use == "observe"
        operator = OperatorSocket(OBSERVER_LIMIT if observes else self.context.rules.message_limit)
        await self._serve(operator, permit, request)
        return operator

    async def _serve(self, operator: OperatorSocket, permit: Permit, request: web.Request) -> None:
        robot, user = permit.robot, permit.user
        address = request.headers.get("X-Forwarded-For")
        bridge = self._bridge(operator, permit, address, self._topic_sharing(permit, request))
        connection = Connection(
            user.id, user.name, robot, permit.use, bridge.end, level=permit.level
        )
        if (why := self.context.handlers.connections.no_room(connection)) is not None:
            bridge.end(close_reasons.too_many_connections(why))
        try:
            # Before anything waits: a right that ends in the meantime must end this connection. And before a lease: its
            # line comes to the agent behind the one that asks for quick heartbeats.
            with self.context.handlers.counted(connection, permit.credential):
                await operator.open(request)
                close_reason = await OperatorSession(
                    bridge, connection, permit.credential, self.context, address
                ).run()
            await bridge.farewell(close_reason)
        finally:
            bridge.release()

    def _topic_sharing(self, permit: Permit, request: web.Request) -> TopicSharing:
        observes = permit.use == "observe"
        if observes and (key := key_of(request.headers)) is not None:
            forwarded = self.context.handlers.registry.ensure_robot(
                permit.robot.id
            ).forwarded_topics
            return ForwardedTopics(key, permit.user.id, forwarded)
        user_ids = (permit.user.id,)
        limit = MAX_TOPICS if not observes else MAX_OBSERVED_TOPICS
        if permit.user.id == RECORDER.id:
            limit = MAX_STANDING_TOPICS
        return TopicCopies(permit.robot, lambda: user_ids, self.context.rules.shared_topics, limit)

    def _bridge(
        self,
        operator: OperatorSocket,
        permit: Permit,
        address: str | None,
        topics: TopicSharing,
    ) -> Bridge:
        robot, rules = permit.robot, self.context.rules
        policy = robot.settings.policy
        return Bridge(
            robot.name,
            validator=MessageValidator(
                policy.of(permit.level), robot.settings.guard.drive_topics, policy.limits
            ),
            operator=operator,
            own=OwnOperations(self.context.control, robot, permit.user.name, address),
            topics=topics,
            limits=rules.limits if permit.use == "observe" else rules.driver_limits,
            message_limit=rules.message_limit,
            traffic=rules.traffic,
        )


class DriverEnd(Protocol):
    """What passes a connection's messages: an operator's `Bridge`, or routes."""

    refused: Counter[str]

    @property
    def bytes_passed(self) -> int:
        """How many bytes of messages went either way."""

    async def run(self, connect: Callable[[], Awaitable[RobotEnd]]) -> CloseReason:
        """Reach the robot and pass messages; return why that ended."""

    def show_seen(self, report: SeenReport) -> None:
        """Report how old is what the driver saw at the newest command."""

    async def close_reason_of_gone(self) -> CloseReason:
        """Return why a connection that is gone ended."""


@dataclass
class OperatorSession:
    """One connection from its upgrade to its ending: lease, way to the robot, and reports.

    `credential` is the login or token that must be valid to begin a drive, except for routes.
    """

    bridge: DriverEnd
    connection: Connection
    credential: Credential | None
    context: SessionContext
    address: str | None
    drive: DriveLog | None = None

    async def run(self) -> CloseReason:
        """Pass messages until the end; the lease is over before anybody is notified."""
        loop = asyncio.get_running_loop()
        begun_at, close_reason = (
            loop.time(),
            close_reasons.client_vanished(self.connection.robot.name),
        )
        try:
            close_reason = await self.bridge.run(self._connect_robot)
        except asyncio.CancelledError:
            # aiohttp cancels the handler of a connection that is gone, also before it has read
            # the close frame of a client that does not wait for ours.
            self._end_lease()
            close_reason = await self.bridge.close_reason_of_gone()
            raise
        finally:
            self._end_lease()
            self._send_report(close_reason, loop.time() - begun_at)
        return close_reason

    async def _connect_robot(self) -> RobotEnd:
        robot, dialer = self.connection.robot, self.context.handlers.dialer
        if self.connection.use != "drive":
            socket, lease = await dialer.open(robot, None), None
        else:
            # A page that waits for an offline robot must not use numbers up.
            self.context.handlers.registry.online_presence(robot)
            if not self.connection.is_route:
                await self.context.handlers.check_credential(self.credential, robot)
            driver = await self.context.control.leasing.begin(self.connection)
            socket = await dialer.open(robot, driver.fence)
            lease = self._lease(driver)
        self.context.handlers.connections.connected(self.connection)
        self._send_report()
        counted = self.context.handlers.counted_uplink(self.connection, socket.received_bytes)
        return RobotEnd(socket, lease, counted)

    def _lease(self, driver: Driver) -> DriveLease:
        robot, guard = self.connection.robot, self.connection.robot.settings.guard
        live = self.context.handlers.registry.ensure_robot(robot.id)
        link, presence = live.session, live.presence
        entry = DriveEntry(
            robot.id,
            robot.name,
            self.connection.user,
            driver.fence,
            utc_now(),
            self.address,
            robot_key=robot.fingerprint,
            agent_version=presence.agent_version,
            server_version=__version__,
        )
        self.drive = DriveLog(
            entry,
            guard.deadman_ms / 1000,
            self.bridge.refused,
            self._counters(),
            self.bridge.show_seen,
        )
        guarded = link is not None and presence.guard_mode == "on"
        return DriveLease(
            fence=driver.fence,
            max_age_s=guard.max_age_ms / 1000,
            clock=link.clock if link is not None and guarded else None,
            log=self.drive,
            on_command=lambda: driver.on_command(now()),
            on_report=partial(self._on_command, driver.fence),
            robots_frame=partial(live.delivered_frames.robots, self.connection.user_id),
        )

    def _on_command(self, fence: int, report: CommandReport) -> None:
        age_s = report.age_s
        if report.outcome == "sent" and age_s is not None:
            self.context.rules.traffic.command_ages.add(age_s)
            self.context.rules.traffic.count_to_robot(report.size)
        if recorders := self._recorders:
            recorders.send("commands", partial(self._recorded, fence, report))

    def _recorded(self, fence: int, report: CommandReport) -> Mapping[str, object]:
        command, age_s, seen = report.command, report.age_s, report.command.stamp.seen or ()
        return {
            "topic": command.topic,
            "person": self.connection.user,
            "fence": fence,
            "age_ms": None if age_s is None else age_s * 1000,
            "outcome": report.outcome,
            "speed_m_s": command.speed_m_s,
            "turn_rad_s": command.turn_rad_s,
            "message": write_json(command.message.get("msg", {})).decode(),
            "seen_cameras": [named.camera for named in seen],
            "seen_frames": [-1 if named.frame is None else named.frame for named in seen],
        }

    def _on_round_trip(self, driver_ms: float, robot_ms: float | None) -> None:
        self.context.rules.traffic.round_trips.add(driver_ms / 1000)
        if recorders := self._recorders:
            person = self.connection.user
            recorders.send(
                "round_trips",
                partial(dict, person=person, driver_ms=driver_ms, robot_ms=robot_ms),
            )

    @property
    def _recorders(self) -> Recorders:
        return self.context.handlers.registry.robot(self.connection.robot.id).recorders

    def _counters(self) -> DriveCounters:
        robot_id, user_id = self.connection.robot.id, self.connection.user_id
        robot = self.context.handlers.registry.ensure_robot(robot_id)
        return DriveCounters(
            passed_bytes=lambda: self.bridge.bytes_passed,
            robot_rtt_ms=lambda: robot.presence.rtt_ms,
            viewer_counts=partial(robot.viewer_stats.of, user_id),
            on_round_trip=self._on_round_trip,
            position=robot.position_now,
        )

    def _end_lease(self) -> None:
        if self.connection.use == "drive":
            self.context.control.leasing.end(self.connection)

    def _send_report(self, close_reason: CloseReason | None = None, lasted_s: float = 0.0) -> None:
        self.context.report(
            ConnectionReport(
                self.connection,
                self.address,
                close_reason,
                lasted_s,
                self.drive,
                self.bridge.refused,
            )
        )
