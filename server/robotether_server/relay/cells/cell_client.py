"""Opens WebSockets to the peer listeners of other cells, for an observer, a topic that clients share, or a route.

`forwarding`, `channels/rosbridge/topic_link` and `routes/cell_sources` open them, and `cell_metrics` reads by it; nginx
forwards all else.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass

from aiohttp import ClientError, ClientSession, WSServerHandshakeError
from yarl import URL

from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.cells.keys import SERVER_NAME, PeerKeys
from robotether_server.relay.cells.peers import Peer, Peers
from robotether_server.relay.channels.rosbridge.forwarded_topics import KEY_HEADER
from robotether_server.relay.http.close_reasons import CloseReason, ConnectionClosedError
from robotether_server.relay.http.sockets import RobotSocket, connect_robot
from robotether_server.relay.robots.media_dialer import MediaDialer, MediaPath

TOPICS_PATH = "/cell/v1/topics"
CONNECT_WITHIN_S = 3.0
# Time limit for what is read at once; nginx and Prometheus wait for 10 s.
READ_WITHIN_S = 5.0
# Time without data after which a ping asks whether the other cell still is; that one pings more often.
PING_AFTER_S = 30.0


@dataclass(frozen=True)
class CellClient:
    """The way to all other cells; what they notify this one of begins with its `topics_key`."""

    client: ClientSession
    keys: PeerKeys
    topics_key: bytes

    async def open(
        self,
        peer: Peer,
        path: str,
        message_limit: int,
        headers: Mapping[str, str] | None = None,
        ping_after_s: float | None = None,
    ) -> RobotSocket:
        """Open a WebSocket; raise ClientError, OSError or TimeoutError. The path is encoded, with its query."""
        async with asyncio.timeout(CONNECT_WITHIN_S):
            return await connect_robot(
                self.client,
                URL(f"https://{peer.address}{path}", encoded=True),
                message_limit,
                headers={**(headers or {}), KEY_HEADER: self.topics_key.decode()},
                heartbeat=ping_after_s,
                ssl=self.keys.tls,
                server_hostname=SERVER_NAME,
            )

    async def follow(self, peer: Peer, path: str, message_limit: int) -> RobotSocket:
        """Open a WebSocket whose end is noticed, too; raise ConnectionClosedError with what people read."""
        try:
            return await self.open(peer, path, message_limit, ping_after_s=PING_AFTER_S)
        except WSServerHandshakeError as exc:
            why = f"cell {peer.name} answered HTTP {exc.status}; is its version older?"
        except TimeoutError:
            why = f"cell {peer.name} does not answer in time"
        except (ClientError, OSError):
            why = f"cell {peer.name} cannot be reached"
        raise ConnectionClosedError(CloseReason("link_lost", why))

    async def read(self, peer: Peer, path: str) -> bytes:
        """Return what a path answers with status 200; raise ClientError, OSError or TimeoutError."""
        async with (
            asyncio.timeout(READ_WITHIN_S),
            self.client.get(
                URL(f"https://{peer.address}{path}", encoded=True),
                headers={"Accept-Encoding": "identity"},
                ssl=self.keys.tls,
                server_hostname=SERVER_NAME,
                raise_for_status=True,
            ) as answer,
        ):
            return await answer.read()


@dataclass(frozen=True)
class CellTopicDialer:
    """The way to topics of robots here and at other cells."""

    media: MediaDialer
    peers: Peers
    cells: CellClient | None

    async def open(self, robot: RelayRobot, media_path: MediaPath, within_s: float) -> RobotSocket:
        """Open a WebSocket to the robot's topics service, or to its cell; raise ConnectionClosedError."""
        peer = self.peers.owner(robot.id)
        if peer is None or self.cells is None:
            return await self.media.open(robot, media_path, within_s)
        path = URL.build(path=f"{TOPICS_PATH}/{robot.id}", query=media_path.query)
        return await self.cells.follow(peer, str(path), media_path.message_limit)
