"""Answers /robots/NAME/ros: lets an operator in, reaches the robot, and has a `Bridge` run.

What concerns ticket, origin or name is refused over HTTP; browsers cannot read such an answer's
body, so all that concerns the robot is told after the upgrade, as a close code with a reason.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

from aiohttp import web

from robotether_server.problems import HttpProblem, StoreUnavailable
from robotether_server.relay import endings
from robotether_server.relay.access import Permit, request_of
from robotether_server.relay.bridge import Bridge, Reached, Traffic
from robotether_server.relay.connections import Connection
from robotether_server.relay.control import Control
from robotether_server.relay.drive_log import DriveLog, Meters
from robotether_server.relay.drive_path import Seat
from robotether_server.relay.endings import EndedError, Ending
from robotether_server.relay.liveness import Limits
from robotether_server.relay.means import Means
from robotether_server.relay.operations import Gate
from robotether_server.relay.own_operations import OwnOperations
from robotether_server.relay.reach import Reach
from robotether_server.relay.sessions import utc_now
from robotether_server.relay.sockets import OperatorSocket
from robotether_server.store.control import DriveEntry
from robotether_server.store.fleet import Credential

# What an observer may say is short, and parsing it holds up everybody else.
OBSERVER_LIMIT = 64 * 1024


@dataclass(frozen=True)
class BridgeRules:
    """What is the same for all bridges of a relay."""

    limits: Limits
    driver_limits: Limits
    message_limit: int
    traffic: Traffic


@dataclass(frozen=True)
class ConnectionReport:
    """What `reports` learns of a connection; ending None: it has reached the robot."""

    connection: Connection
    address: str | None
    ending: Ending | None = None
    lasted_s: float = 0.0
    drive: DriveLog | None = None
    refused: Mapping[str, int] = field(default_factory=dict)


class RosbridgeHandler:
    """Answers /robots/NAME/ros."""

    def __init__(
        self,
        means: Means,
        control: Control,
        *,
        rules: BridgeRules,
        report: Callable[[ConnectionReport], None],
    ) -> None:
        self._means = means
        self._control = control
        self._rules = rules
        self._report = report
        self._reach = Reach(means.client, means.tunnel_host, means.registry, rules.message_limit)

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Join an operator's WebSocket to the robot until one of them ends."""
        if not web.WebSocketResponse().can_prepare(request):
            raise HttpProblem(426, "cannot open rosbridge: connect with a WebSocket")
        asked = request_of(request.headers, request.cookies, request.query)
        permit = self._means.access.for_rosbridge(asked, request.match_info["name"])
        observes = permit.use == "observe"
        operator = OperatorSocket(OBSERVER_LIMIT if observes else self._rules.message_limit)
        await self._serve(operator, permit, request)
        return operator

    async def _serve(self, operator: OperatorSocket, permit: Permit, request: web.Request) -> None:
        robot, user = permit.robot, permit.user
        address = request.headers.get("X-Forwarded-For")
        bridge = self._bridge(operator, permit, address)
        connection = Connection(
            user.id, user.name, robot, permit.use, bridge.end, level=permit.level
        )
        if (why := self._means.connections.no_room(connection)) is not None:
            bridge.end(endings.too_many_connections(why))
        gone = partial(bridge.end, endings.rights_ended(robot.name))
        try:
            # Before anything waits: a right that ends in the meantime must end this connection.
            with (
                self._means.connections.joined(connection),
                self._means.credentials.held(permit.credential, gone),
            ):
                await operator.open(request)
                ending = await Visit(
                    bridge,
                    connection,
                    permit.credential,
                    self._means,
                    self._control,
                    self._reach,
                    self._report,
                    address,
                ).run()
            await bridge.farewell(ending)
        finally:
            bridge.release()

    def _bridge(self, operator: OperatorSocket, permit: Permit, address: str | None) -> Bridge:
        robot, rules = permit.robot, self._rules
        policy = robot.settings.policy
        return Bridge(
            robot.name,
            gate=Gate(policy.of(permit.level), robot.settings.guard.drive_topics, policy.limits),
            operator=operator,
            own=OwnOperations(self._control, robot, permit.user.name, address),
            limits=rules.limits if permit.use == "observe" else rules.driver_limits,
            message_limit=rules.message_limit,
            traffic=rules.traffic,
        )


@dataclass
class Visit:
    """One connection from its upgrade to its ending: lease, way to the robot, and reports."""

    bridge: Bridge
    connection: Connection
    credential: Credential
    means: Means
    control: Control
    way: Reach
    report: Callable[[ConnectionReport], None]
    address: str | None
    drive: DriveLog | None = None

    async def run(self) -> Ending:
        """Pass messages until the end; the lease is over before anybody is told."""
        loop = asyncio.get_running_loop()
        begun_at, ending = loop.time(), endings.client_vanished(self.connection.robot.name)
        try:
            ending = await self.bridge.run(self._reach)
        except asyncio.CancelledError:
            # aiohttp cancels the handler of a connection that is gone, also before it has read
            # the close frame of a client that does not wait for ours.
            self._leave_seat()
            ending = await self.bridge.ending_of_gone()
            raise
        finally:
            self._leave_seat()
            self._tell(ending, loop.time() - begun_at)
        return ending

    async def _reach(self) -> Reached:
        if self.connection.use != "drive":
            socket, seat = await self.way.open(self.connection.robot, None), None
        else:
            # A page that waits for an offline robot must not use numbers up.
            self.way.check_online(self.connection.robot)
            await self._check_credential()
            fence = await self.control.leasing.begin(self.connection)
            socket, seat = await self.way.open(self.connection.robot, fence), self._seat(fence)
        self.means.connections.reached(self.connection)
        self._tell()
        return Reached(socket, seat)

    async def _check_credential(self) -> None:
        """Let nobody drive with a ticket whose login or token has ended since; `held` alone would a second later."""
        name = self.connection.robot.name
        try:
            holds = await self.means.credentials.holds(self.credential)
        except StoreUnavailable as problem:
            # A lease would not get its number either.
            raise EndedError(endings.lease_unavailable(name)) from problem
        if not holds:
            raise EndedError(endings.rights_ended(name))

    def _seat(self, fence: int) -> Seat:
        robot, guard = self.connection.robot, self.connection.robot.settings.guard
        entry = DriveEntry(
            robot.id, robot.name, self.connection.user, fence, utc_now(), self.address
        )
        self.drive = DriveLog(entry, guard.deadman_ms / 1000, self.bridge.refused, self._meters())
        presence, link = (
            self.means.registry.presence(robot.id),
            self.means.registry.session_of(robot.id),
        )
        guarded = link is not None and presence.guard_mode == "on"
        return Seat(
            fence=fence,
            max_age_s=guard.max_age_ms / 1000,
            clock=link.clock if link is not None and guarded else None,
            log=self.drive,
            came=partial(self.control.leasing.command_came, robot.id),
        )

    def _meters(self) -> Meters:
        robot_id, user_id = self.connection.robot.id, self.connection.user_id
        registry = self.means.registry
        return Meters(
            passed_bytes=lambda: self.bridge.bytes_passed,
            robot_rtt_ms=lambda: registry.presence(robot_id).rtt_ms,
            delivered=partial(self.means.deliveries.of, robot_id, user_id),
        )

    def _leave_seat(self) -> None:
        if self.connection.use == "drive":
            self.control.leasing.end(self.connection)

    def _tell(self, ending: Ending | None = None, lasted_s: float = 0.0) -> None:
        self.report(
            ConnectionReport(
                self.connection, self.address, ending, lasted_s, self.drive, self.bridge.refused
            )
        )
