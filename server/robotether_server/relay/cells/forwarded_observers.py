"""Passes an observer's connection on to the cell that has the robot, and gives it topics that the cell's clients share.

`forwarding` starts one for each observer of a robot elsewhere; drivers' connections go through nginx alone, so that no
command passes two relays. The robot's cell checks and answers all that the observer sends. What it lets the observer
have of topics it notifies this relay of, which takes one copy of each over the line between the cells.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import partial

from aiohttp import ClientError, WSMsgType, web

from robotether_server.contract.codes import CLOSE_CODES
from robotether_server.db.fleet import RelayRobot
from robotether_server.problems import reason_in
from robotether_server.relay.auth.access import HandlerContext, credential_in
from robotether_server.relay.cells.cell_client import CellClient
from robotether_server.relay.cells.peers import Peer, Peers
from robotether_server.relay.channels.rosbridge.bridge import PASSED_ON, Traffic
from robotether_server.relay.channels.rosbridge.forwarded_topics import ShareNotice, read_notice
from robotether_server.relay.channels.rosbridge.handler import OBSERVER_LIMIT, BridgeRules
from robotether_server.relay.channels.rosbridge.message_validator import (
    FLOOD_AFTER_S,
    MIN_FLOOD_PER_S,
)
from robotether_server.relay.channels.rosbridge.subscriptions import TopicCopies
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.http.event_loop import next_turn
from robotether_server.relay.http.sockets import (
    SEND_BUFFER_BYTES,
    ClientConnection,
    OperatorSocket,
    RobotSocket,
)
from robotether_server.relay.http.timing import Excess
from robotether_server.relay.robots.connection import Connection
from robotether_server.relay.robots.robot import Change
from robotether_server.tickets import Ticket

log = logging.getLogger(__name__)

# What the robot's cell decides by.
PASSED_HEADERS = ("Host", "Origin", "X-Forwarded-For")
NAMES = {code.number: name for name, code in CLOSE_CODES.items()}


@dataclass(frozen=True)
class ForwardedObservers:
    """All observers here of robots at other cells."""

    cells: CellClient | None
    peers: Peers
    context: HandlerContext
    rules: BridgeRules

    async def join(
        self, request: web.Request, ticket: Ticket, robot: RelayRobot, peer: Peer
    ) -> web.StreamResponse | None:
        """Join an observer to the robot's cell until one of them ends; None: that cell refuses, or is not reached."""
        if self.cells is None:
            return None
        headers = {
            name: request.headers[name] for name in PASSED_HEADERS if name in request.headers
        }
        try:
            cell = await self.cells.open(peer, request.path_qs, self.rules.message_limit, headers)
        except (ClientError, OSError) as exc:
            why = reason_in(exc)
            log.info("robot %s: cell %s does not take an observer: %s", robot.name, peer.name, why)
            return None
        operator = OperatorSocket(OBSERVER_LIMIT)
        user_ids = (ticket.user_id,)
        topics = TopicCopies(robot, lambda: user_ids, self.rules.shared_topics)
        observer = ForwardedObserver(
            robot.name, operator, cell, topics, rules=self.rules, key=self.cells.topics_key
        )
        connection = Connection(
            ticket.user_id, ticket.user, robot, "observe", observer.end, cell=peer.name
        )
        on_rights_ended = partial(observer.end, close_reasons.rights_ended(robot.name))
        try:
            # The robot's cell ends it, too, but that may wait behind what a slow observer has not read.
            with (
                self.context.connections.joined(connection),
                self.context.credentials.held(credential_in(ticket), on_rights_ended),
            ):
                # Meanwhile the robot may have left that cell.
                self.on_peer_robot(robot.id)
                await operator.open(request)
                close_reason = await observer.run()
            if close_reason.name == "client_left":
                await cell.leave()
            await operator.finish(close_reason)
        finally:
            cell.drop()
        return operator

    def on_robot_change(self, change: Change) -> None:
        """Something happened to a robot here: it may have come from another cell."""
        if change.what != "heartbeat":
            self.on_peer_robot(change.robot_id)

    def on_peer_robot(self, robot_id: int) -> None:
        """End those whose robot is no longer at the cell that they go through, with what they share."""
        peer = self.peers.owner(robot_id)
        left = [
            member
            for member in self.context.registry.robot(robot_id).connections
            if member.cell and (peer is None or peer.name != member.cell)
        ]
        for member in left:
            member.end(close_reasons.link_lost(member.robot.name))
        if left:
            self.rules.shared_topics.end_all_of(robot_id)


class ForwardedObserver(ClientConnection):
    """One observer's connection."""

    def __init__(
        self,
        robot: str,
        operator: OperatorSocket,
        cell: RobotSocket,
        topics: TopicCopies,
        *,
        rules: BridgeRules,
        key: bytes,
    ) -> None:
        super().__init__(robot, operator, rules.limits)
        self._cell = cell
        self._topics = topics
        self._traffic: Traffic = rules.traffic
        self._key = key
        self._pings = Excess(self._received_s, per_s=MIN_FLOOD_PER_S, for_s=FLOOD_AFTER_S)
        self._bytes_to_cell = 0

    async def run(self) -> CloseReason:
        """Pass messages until the end; return why."""
        try:
            return await self._run_until_ended(
                self._run_together(
                    self._pump_to_cell(),
                    self._pump_to_client(),
                    self._topics.send(self._deliver),
                )
            )
        finally:
            self._topics.close()

    async def _pump_to_cell(self) -> CloseReason:
        count = 0
        while True:
            count = await next_turn(count)
            message = await self._receive()
            if message.type is WSMsgType.PING or message.type is WSMsgType.PONG:
                if self._pings.add(self._received_s, 1):
                    return close_reasons.client_floods(self.name)
                if message.type is WSMsgType.PING:
                    await self._socket.pong(message.data)
            elif message.type in PASSED_ON:
                self._bytes_to_cell += len(message.data)
                try:
                    await self._cell.send_frame(message.data, message.type)
                except ConnectionError:
                    return close_reasons.link_lost(self.name)
            else:
                return self._close_reason_by_client(message)

    async def _pump_to_client(self) -> CloseReason:
        while True:
            message = await self._cell.next_message()
            if message.type is WSMsgType.BINARY and message.data.startswith(self._key):
                notice = read_notice(self._key, message.data)
                if isinstance(notice, ShareNotice):
                    self._topics.share(
                        notice.topic,
                        notice.subscription,
                        notice.message_id,
                        is_new=notice.is_new,
                    )
            elif message.type is WSMsgType.TEXT or message.type is WSMsgType.BINARY:
                await self._deliver(message.data, message.type)
            elif message.type is WSMsgType.CLOSE and message.data in NAMES:
                return CloseReason(NAMES[message.data], str(message.extra))
            else:
                return close_reasons.link_lost(self.name)

    async def _deliver(self, data: bytes, kind: WSMsgType) -> None:
        self._traffic.count_to_client(len(data))
        self._bytes_to_client += len(data)
        if len(data) > SEND_BUFFER_BYTES:
            with self._traffic.taken(self, len(data)):
                await self._socket.send_large(data, kind, self._traffic.piece_turns)
        else:
            await self._socket.send_frame(data, kind)

    def _to_robot(self) -> tuple[int, int]:
        return self._bytes_to_cell, self._cell.waiting_bytes()
