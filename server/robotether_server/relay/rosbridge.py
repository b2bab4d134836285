"""Answers /robots/NAME/ros: lets an operator in, reaches the robot, and has a `Bridge` run.

What concerns ticket, origin or name is refused over HTTP; browsers cannot read such an answer's
body, so all that concerns the robot is told after the upgrade, as a close code with a reason.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, cast

from aiohttp import (
    ClientConnectorError,
    ClientError,
    ClientWSTimeout,
    WSServerHandshakeError,
    web,
)

from robotether_server.problems import HttpProblem
from robotether_server.relay import endings
from robotether_server.relay.access import Permit, request_of
from robotether_server.relay.bridge import Bridge, BridgeRules, EndedError
from robotether_server.relay.connections import Connection
from robotether_server.relay.endings import Ending
from robotether_server.relay.means import Means
from robotether_server.relay.sessions import Presence, utc_now
from robotether_server.relay.sockets import (
    LIMIT_MARGIN,
    ROBOT_FAREWELL_S,
    OperatorSocket,
    RobotSocket,
)
from robotether_server.store.fleet import Robot

log = logging.getLogger(__name__)

# An operator is told within a second when rosbridge does not answer; a robot far away gets as
# many of its round trips more as opening a channel and a WebSocket needs, and some to spare.
PATIENCE_S = 0.8
PATIENCE_ROUND_TRIPS = 8
LONGEST_PATIENCE_S = 5.0
# What an observer may say is short, and parsing it holds up everybody else.
OBSERVER_LIMIT = 64 * 1024
# The session is there some milliseconds before its forward is.
FORWARD_WITHIN_S = 0.6
RETRY_S = 0.03


@dataclass(frozen=True)
class ConnectionReport:
    """What `reports` learns of a connection; ending None: it has reached the robot."""

    connection: Connection
    address: str | None
    ending: Ending | None = None
    lasted_s: float = 0.0


class RosbridgeHandler:
    """Answers /robots/NAME/ros."""

    def __init__(
        self, means: Means, *, rules: BridgeRules, report: Callable[[ConnectionReport], None]
    ) -> None:
        self._means = means
        self._rules = rules
        self._report = report

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
        robot = permit.robot
        bridge = Bridge(robot.name, _mode(permit), operator, self._rules)
        connection = Connection(permit.user.id, permit.user.name, robot, permit.use, bridge.end)
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
                ending = await self._run(bridge, connection, request.headers.get("X-Forwarded-For"))
            await bridge.farewell(ending)
        finally:
            bridge.release()

    async def _run(self, bridge: Bridge, connection: Connection, address: str | None) -> Ending:
        loop = asyncio.get_running_loop()
        begun_at, ending = loop.time(), endings.client_vanished(connection.robot.name)

        async def reach() -> RobotSocket:
            socket = await self._reach(connection.robot)
            self._means.connections.reached(connection)
            self._report(ConnectionReport(connection, address))
            return socket

        try:
            ending = await bridge.run(reach)
        except asyncio.CancelledError:
            # aiohttp cancels the handler of a connection that is gone, also before it has read
            # the close frame of a client that does not wait for ours.
            ending = await bridge.ending_of_gone()
            raise
        finally:
            lasted_s = loop.time() - begun_at
            self._report(ConnectionReport(connection, address, ending, lasted_s))
        return ending

    async def _reach(self, robot: Robot) -> RobotSocket:
        presence = self._means.registry.presence(robot.id)
        if not presence.online:
            raise EndedError(endings.robot_offline(robot.name, presence.since, utc_now()))
        try:
            async with asyncio.timeout(patience_s(presence)):
                return await self._connect(robot)
        except TimeoutError as exc:
            why = "no answer in time"
            raise EndedError(endings.rosbridge_down(robot.name, why)) from exc

    async def _connect(self, robot: Robot) -> RobotSocket:
        loop = asyncio.get_running_loop()
        deadline = loop.time() + FORWARD_WITHIN_S
        while (socket := await self._open(robot)) is None:
            if loop.time() > deadline:
                raise EndedError(
                    endings.rosbridge_down(robot.name, "the tunnel has no port for it")
                )
            await asyncio.sleep(RETRY_S)
        return socket

    async def _open(self, robot: Robot) -> RobotSocket | None:
        """Open a WebSocket to the robot; None when its port is not there (yet)."""
        try:
            return await self._dial(robot)
        except ClientConnectorError:
            return None
        except (ClientError, OSError) as exc:
            raise EndedError(endings.rosbridge_down(robot.name, _why(exc))) from exc

    async def _dial(self, robot: Robot) -> RobotSocket:
        socket = await self._means.client.ws_connect(
            f"ws://{self._means.tunnel_host}:{robot.ros_port}/",
            compress=0,
            decode_text=False,
            max_msg_size=self._rules.message_limit + LIMIT_MARGIN,
            timeout=ClientWSTimeout(ws_close=ROBOT_FAREWELL_S),
        )
        return cast(RobotSocket, socket)


def patience_s(presence: Presence) -> float:
    """How long to wait for a robot's rosbridge, by how far away the robot is."""
    distance_s = PATIENCE_ROUND_TRIPS * (presence.rtt_ms or 0.0) / 1000
    return min(PATIENCE_S + distance_s, LONGEST_PATIENCE_S)


def _why(error: Exception) -> str:
    if isinstance(error, WSServerHandshakeError):
        return f"it answered HTTP {error.status}"
    return "the robot refuses the connection"


def _mode(permit: Permit) -> Literal["observe", "drive"]:
    return "drive" if permit.use == "drive" else "observe"
