"""Connects to a robot's rosbridge, through its tunnel and its guard.

`rosbridge` asks for one socket a connection. It reports in time why there is none, and shows the guard that
the connection comes from this relay, what it may do, and with which number it drives.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

from aiohttp import (
    ClientConnectorError,
    ClientError,
    ClientSession,
    WSServerHandshakeError,
)
from robotether_common.guard import (
    DISK_REFUSED,
    FENCE_HEADER,
    FENCE_REFUSED,
    KEY_HEADER,
    MODE_HEADER,
)
from yarl import URL

from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import ConnectionClosedError
from robotether_server.relay.http.sockets import RobotSocket, connect_robot, why_refused
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import Presence

# Minimum time limit for connecting: an operator learns within a second that rosbridge does not
# answer. A distant robot gets the round trips that opening a channel and a WebSocket needs, and a
# margin.
MIN_CONNECT_TIMEOUT_S = 0.8
CONNECT_ROUND_TRIPS = 8
MAX_CONNECT_TIMEOUT_S = 5.0
# Time limit for a forward, which follows its session by milliseconds, and for a guard to learn of a
# new lease, which it gets on another channel than the connection.
FORWARD_WITHIN_S = 0.6
RETRY_S = 0.03


@dataclass(frozen=True)
class RobotDialer:
    """The way to all robots' rosbridge, whose ports listen at `tunnel_host`."""

    client: ClientSession
    tunnel_host: str
    registry: SessionRegistry
    message_limit: int

    async def open(self, robot: RelayRobot, fence: int | None) -> RobotSocket:
        """Open a WebSocket to the robot, to drive with this number or to observe; raise ConnectionClosedError."""
        presence, loop = self.registry.online_presence(robot), asyncio.get_running_loop()
        headers = self._headers(robot, fence)
        why = "no answer in time"
        try:
            async with asyncio.timeout(connect_timeout_s(presence)):
                if fence is not None and (link := self.registry.session_of(robot.id)) is not None:
                    # No command goes before the agent keeps the heartbeats of a robot in use.
                    await link.until_quick()
                deadline = loop.time() + FORWARD_WITHIN_S
                while not isinstance(answer := await self._open(robot, headers), RobotSocket):
                    # The last answer says more than that a later try had none.
                    why = answer
                    if loop.time() > deadline:
                        raise ConnectionClosedError(close_reasons.rosbridge_down(robot.name, why))
                    await asyncio.sleep(RETRY_S)
                return answer
        except TimeoutError as exc:
            raise ConnectionClosedError(close_reasons.rosbridge_down(robot.name, why)) from exc

    def _headers(self, robot: RelayRobot, fence: int | None) -> dict[str, str]:
        link = self.registry.session_of(robot.id)
        key = {} if link is None else {KEY_HEADER: link.guard_key}
        if fence is None:
            return {**key, MODE_HEADER: "observe"}
        return {**key, MODE_HEADER: "drive", FENCE_HEADER: str(fence)}

    async def _open(self, robot: RelayRobot, headers: dict[str, str]) -> RobotSocket | str:
        """Open a WebSocket to the robot; say why there is none, when there may be one soon."""
        try:
            return await self._dial(robot, headers)
        except ClientConnectorError:
            return "the tunnel has no port for it"
        except WSServerHandshakeError as exc:
            if exc.status == FENCE_REFUSED:
                return why_refused(exc, "somebody else drives, or it is stopped, as its guard says")
            is_full = exc.status == DISK_REFUSED
            why = why_refused(exc, "its guard cannot write to the robot's disk" if is_full else "")
            raise ConnectionClosedError(close_reasons.rosbridge_down(robot.name, why)) from exc
        except (ClientError, OSError) as exc:
            why = "the robot refuses the connection"
            raise ConnectionClosedError(close_reasons.rosbridge_down(robot.name, why)) from exc

    async def _dial(self, robot: RelayRobot, headers: dict[str, str]) -> RobotSocket:
        url = URL.build(scheme="ws", host=self.tunnel_host, port=robot.ros_port, path="/")
        socket = await connect_robot(self.client, url, self.message_limit, headers=headers)
        if FENCE_HEADER in headers:
            socket.keep_little()
        return socket


def connect_timeout_s(presence: Presence) -> float:
    """How long to wait for a robot's rosbridge, by how far away the robot is."""
    distance_s = CONNECT_ROUND_TRIPS * (presence.rtt_ms or 0.0) / 1000
    return min(MIN_CONNECT_TIMEOUT_S + distance_s, MAX_CONNECT_TIMEOUT_S)
