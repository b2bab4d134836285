"""Connects to what a robot's agent serves on the media connection: frames of cameras, and topics.

A camera's feed and a topic's each open a WebSocket; whoever opens one has counted itself in the robot's
`media_demand`, so that the agent opens the media connection.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated

import msgspec
from aiohttp import ClientConnectorError, ClientError, ClientSession, WSServerHandshakeError
from msgspec import Meta, Struct
from robotether_common import line_rate
from yarl import URL

from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.http.close_reasons import CloseReason, ConnectionClosedError
from robotether_server.relay.http.sockets import RobotSocket, connect_robot, why_refused
from robotether_server.relay.robots.demand import RETRY_S
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot_dialer import connect_timeout_s
from robotether_server.times import delays

# Time limit and maximum size of a robot's answer that says what its line carries.
LINE_RATE_WITHIN_S = 1.0
MAX_LINE_RATE_BYTES = 200
TOO_MANY = 429
# Maximum time between two tries.
MAX_RETRY_S = 1.0
SERVER_ERRORS = 500


@dataclass(frozen=True)
class MediaPath:
    """What to open.

    `unknown` is why there is none where the robot answers, and knows no such path; `down(robot, why)` where it has none
    to offer.
    """

    path: str
    query: Mapping[str, str]
    message_limit: int
    unknown: CloseReason
    down: Callable[[str, str], CloseReason]


class LineRate(Struct):
    """A robot's answer."""

    bytes_per_s: Annotated[int, Meta(ge=0, le=10**12)] | None


@dataclass(frozen=True)
class MediaDialer:
    """The way to all robots' media services, whose ports listen at `tunnel_host`."""

    client: ClientSession
    tunnel_host: str
    registry: SessionRegistry

    async def open(self, robot: RelayRobot, media_path: MediaPath, within_s: float) -> RobotSocket:
        """Open a WebSocket; ConnectionClosedError when the robot has none to offer within that time."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + within_s
        # What a robot refuses by itself needs longer than a media connection that is about to open.
        pauses = delays(RETRY_S, MAX_RETRY_S)
        while True:
            pause_s = RETRY_S
            presence = self.registry.online_presence(robot)
            try:
                async with asyncio.timeout(connect_timeout_s(presence)):
                    return await self._connect(robot, media_path)
            except ClientConnectorError:
                why = "the tunnel has no port for it"
            except WSServerHandshakeError as exc:
                # web_video_server knows no such path; other servers of video answer any path.
                if exc.status < SERVER_ERRORS and exc.status != TOO_MANY:
                    raise ConnectionClosedError(media_path.unknown) from exc
                why, pause_s = why_refused(exc), next(pauses)
            except TimeoutError:
                why = "no answer in time"
            except (ClientError, OSError):
                why, pause_s = "the robot refuses the connection", next(pauses)
            if (left_s := deadline - loop.time()) <= 0:
                raise ConnectionClosedError(media_path.down(robot.name, why))
            await asyncio.sleep(min(pause_s, left_s))

    async def line_rate(self, robot: RelayRobot) -> int | None:
        """Ask the robot what its line carries, in bytes a second; None: it is not full, or the robot does not say."""
        port, path = robot.video_port, line_rate.PATH
        url = URL.build(scheme="http", host=self.tunnel_host, port=port, path=path)
        try:
            async with asyncio.timeout(LINE_RATE_WITHIN_S), self.client.get(url) as answer:
                text = await answer.content.read(MAX_LINE_RATE_BYTES)
                return msgspec.json.decode(text, type=LineRate).bytes_per_s
        except (TimeoutError, ClientError, OSError, ValueError):
            # What answers may be web_video_server.
            return None

    async def _connect(self, robot: RelayRobot, media_path: MediaPath) -> RobotSocket:
        url = URL.build(
            scheme="ws",
            host=self.tunnel_host,
            port=robot.video_port,
            path=media_path.path,
            query=media_path.query,
        )
        return await connect_robot(self.client, url, media_path.message_limit)
