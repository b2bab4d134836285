"""Answers /cell/v1/topics/ROBOT_ID: gives another cell one copy of a topic, which its clients share.

It answers as the robot's own topics service does (docs/reference/media.md, "Topics"). That cell has let its clients
have the topic only because this one, which checks them, notified it so (`channels/rosbridge/forwarded_topics`).
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from aiohttp import WSMsgType, web
from robotether_common.topics import KNOWN, KNOWN_OP, MAX_SUBSCRIPTION_BYTES

from robotether_server.db.fleet import RelayRobot, Snapshot
from robotether_server.problems import HttpError
from robotether_server.relay.cells.peers import Peers
from robotether_server.relay.channels.rosbridge.forwarded_topics import (
    FailureNotice,
    key_of,
    users_sharing,
    write_notice,
)
from robotether_server.relay.channels.rosbridge.handler import BridgeRules
from robotether_server.relay.channels.rosbridge.operations import (
    NotJsonError,
    read_json,
    write_json,
)
from robotether_server.relay.channels.rosbridge.shared_topics import (
    SharedTopic,
    SharedTopics,
    TopicConnector,
    TopicRequest,
)
from robotether_server.relay.channels.rosbridge.subscriptions import TopicCopies
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.event_loop import next_turn
from robotether_server.relay.http.sockets import OperatorSocket
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.uplink import UserIds
from robotether_server.tasks import run_until_first

# Time limit for the subscription.
SUBSCRIBED_WITHIN_S = 3.0
# Interval between pings, and time limit for the next pong, which waits behind what was sent before.
PING_EVERY_S = 20.0
SILENT_AFTER_S = 60.0
# Time for which the other cell can read that the robot sends too many topics, before it may try again.
REFUSED_FOR_S = 1.0
ROUTE = "/cell/v1/topics/{robot_id:[0-9]{1,18}}"


class PeerCopies(TopicCopies):
    """What waits for a cell; why a topic fails goes there as a notice, which is not a message of the robot's."""

    def __init__(
        self,
        robot: RelayRobot,
        user_ids: UserIds,
        shared_topics: SharedTopics,
        key: bytes,
    ) -> None:
        super().__init__(robot, user_ids, shared_topics)
        self._key = key

    def on_topic_failed(self, topic: str, why: str) -> None:
        """The topic brings nothing for now."""
        self._add_status(write_notice(self._key, FailureNotice(why)), WSMsgType.BINARY)


@dataclass(frozen=True)
class PeerTopicsHandler:
    """Answers /cell/v1/topics/ROBOT_ID."""

    snapshot: Callable[[], Snapshot]
    registry: SessionRegistry
    peers: Peers
    rules: BridgeRules
    connector: TopicConnector

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Send the topic until the other cell leaves, or the robot."""
        key, robot = key_of(request.headers), self._robot(int(request.match_info["robot_id"]))
        socket = OperatorSocket(MAX_SUBSCRIPTION_BYTES)
        if key is None or not socket.can_prepare(request):
            raise HttpError(426, "cannot share a topic: connect with a WebSocket, and a key")
        if robot is None:
            raise HttpError(404, "cannot share a topic: the robot is not at this cell")
        await socket.open(request)
        subscription = await _subscription(socket)
        if subscription is not None and KNOWN in request.query:
            digests = request.query[KNOWN].split(",")
            async for each in self.connector.repeat(SharedTopic(robot, subscription), digests):
                await socket.send_frame(
                    write_json({"op": KNOWN_OP, "digest": each}), WSMsgType.TEXT
                )
        elif subscription is not None:
            members = self.registry.ensure_robot(robot.id).forwarded_topics
            user_ids = partial(users_sharing, members, key, subscription)
            copies = PeerCopies(robot, user_ids, self.rules.shared_topics, key)
            await self._send(socket, copies, subscription)
        await socket.finish(close_reasons.client_left(robot.name))
        return socket

    def _robot(self, robot_id: int) -> RelayRobot | None:
        """Return a robot that is here: two cells that each take the other for the robot's must not wait in a circle."""
        is_here = self.registry.presence(robot_id).online and self.peers.owner(robot_id) is None
        return self.snapshot().robots.get(robot_id) if is_here else None

    async def _send(
        self, socket: OperatorSocket, copies: PeerCopies, subscription: TopicRequest
    ) -> None:
        deliver = partial(socket.send_message, turns=self.rules.traffic.piece_turns)
        copies.share(subscription.topic, subscription)
        shared = copies.joined.get(subscription.topic)
        ended = asyncio.sleep(REFUSED_FOR_S) if shared is None else shared.ended.wait()
        try:
            await run_until_first(copies.send(deliver), listen(socket), _ping(socket), ended)
        finally:
            copies.close()


async def _subscription(socket: OperatorSocket) -> TopicRequest | None:
    """Return what the other cell subscribes to; None: nothing that can be read."""
    try:
        message = await socket.receive(SUBSCRIBED_WITHIN_S)
        request = read_json(message.data) if message.type is WSMsgType.TEXT else {}
        return TopicRequest.of(request)
    except (TimeoutError, NotJsonError, KeyError):
        return None


async def listen(socket: OperatorSocket) -> None:
    """Answer pings until the other cell is gone."""
    count = 0
    while True:
        count = await next_turn(count)
        try:
            message = await socket.receive(SILENT_AFTER_S)
        except TimeoutError:
            return
        if message.type is WSMsgType.PING:
            await socket.pong(message.data)
        elif message.type is not WSMsgType.PONG:
            return


async def _ping(socket: OperatorSocket) -> None:
    while True:
        await socket.ping()
        await asyncio.sleep(PING_EVERY_S)
