"""Brings a route's messages from the cell that has its source to the one that has its target, which runs the route.

Both cells know the route, and each ends the connection when its own rights or robots say so: the one asks for the route
by its number (`CellSources`), the other answers /cell/v1/routes/NUMBER (`CellSourceHandler`). The newest message
crosses, at most at the route's rate, and behind its age up to there; pings bound the rest.
"""

from __future__ import annotations

import asyncio
import math
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from aiohttp import ClientError, WSMsgType, web

from robotether_server.db.fleet import RelayRobot
from robotether_server.db.routes import RelayRoute
from robotether_server.problems import HttpError, RobotetherError
from robotether_server.relay.cells.cell_client import CellClient
from robotether_server.relay.cells.cell_topics import listen
from robotether_server.relay.cells.messages import PeerApp
from robotether_server.relay.cells.peers import Peer, Peers
from robotether_server.relay.channels.rosbridge.drive_path import CommandTimestamps
from robotether_server.relay.channels.rosbridge.shared_topics import SharedTopics
from robotether_server.relay.channels.rosbridge.topic_link import date
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import ConnectionClosedError
from robotether_server.relay.http.event_loop import PieceTurns
from robotether_server.relay.http.sockets import (
    OperatorSocket,
    RobotSocket,
    own_words,
)
from robotether_server.relay.routes.apps import App
from robotether_server.relay.routes.source import LOOK_EVERY_S, RouteSource, SourceMessage
from robotether_server.tasks import end_tasks, run_until_first, wait_for_event
from robotether_server.times import delays

ROUTES_PATH = "/cell/v1/routes"
ROUTE = f"{ROUTES_PATH}/{{route_id:[0-9]{{1,10}}}}"
# Maximum size of a message from the cell that reads; it sends none.
MAX_REQUEST_BYTES = 1024
FIRST_PAUSE_S, MAX_PAUSE_S = 0.2, 2.0
# Interval between looks at the rights.
CHECK_EVERY_S = 0.5
# Seconds by which a message was older, at most, when it was sent; not a number: unknown.
AGE = struct.Struct("!d")


class ReadableSource(NamedTuple):
    """A route whose source is here, for the cell that runs it. `is_drive`: it leads to a drive topic."""

    route: RelayRoute
    source: RelayRobot | App
    is_drive: bool


@dataclass(frozen=True)
class CellSources:
    """Brings messages from other cells; without `cells` there are none."""

    cells: CellClient | None
    peers: Peers
    message_limit: int

    def owner(self, route: RelayRoute) -> Peer | None:
        """Return the other cell that has a route's source; None: none has."""
        if route.source_id is not None:
            return self.peers.owner(route.source_id)
        app = self.app(route)
        return None if app is None else app[0]

    def app(self, route: RelayRoute) -> tuple[Peer, PeerApp] | None:
        """Return the app of another cell that is a route's source, with its cell; None: no other cell has it."""
        return self.peers.owner_of_app(route.user_id, route.source_app or "")

    async def bring(self, source: RouteSource) -> None:
        """Bring a route's messages until this is cancelled."""
        pauses = delays(FIRST_PAUSE_S, MAX_PAUSE_S)
        while True:
            try:
                source.problem = await self._bring(source)
            except ConnectionClosedError as closed:
                source.problem = closed.close_reason.reason
            except (ClientError, OSError):
                source.problem = "the connection to the source's cell broke"
            await asyncio.sleep(next(pauses))

    async def _bring(self, source: RouteSource) -> str:
        """Bring messages until the connection ends; return why."""
        peer = self.owner(source.route)
        if peer is None or self.cells is None:
            return "the source's cell is not connected"
        # The other cell may send at once, before this one knows that the connection is open.
        timestamps = CommandTimestamps(time.monotonic())
        socket = await self.cells.follow(
            peer, f"{ROUTES_PATH}/{source.route.id}", self.message_limit + AGE.size
        )
        is_dated = asyncio.Event()
        if source.is_drive:
            is_dated.set()
        dating = asyncio.create_task(date(socket, is_dated, timestamps))
        try:
            return await self._read(socket, source, timestamps)
        finally:
            await end_tasks([dating])
            socket.drop()

    async def _read(
        self, socket: RobotSocket, source: RouteSource, timestamps: CommandTimestamps
    ) -> str:
        def on_control(kind: WSMsgType, payload: bytes) -> None:
            if kind is WSMsgType.PONG:
                timestamps.pong(payload)

        while True:
            message = await socket.next_message(on_control)
            if message.type is WSMsgType.BINARY and len(message.data) >= AGE.size:
                source.receive(_message_in(message.data, timestamps))
            elif message.type is WSMsgType.TEXT:
                source.problem = own_words(message.data.decode(errors="replace"))
            elif message.type is WSMsgType.CLOSE:
                return own_words(message.extra) or "the source's cell ended the connection"
            else:
                return "the connection to the source's cell broke"


@dataclass(frozen=True)
class CellSourceHandler:
    """Answers /cell/v1/routes/NUMBER. `readable` says which routes may be read here, by their numbers."""

    readable: Callable[[int], ReadableSource | None]
    shared_topics: SharedTopics
    piece_turns: PieceTurns

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Send what the source brings until the route may not be read any more, or the other cell leaves."""
        readable = self.readable(int(request.match_info["route_id"]))
        socket = OperatorSocket(MAX_REQUEST_BYTES)
        if not socket.can_prepare(request):
            raise HttpError(426, "cannot read a route's source: connect with a WebSocket")
        if readable is None:
            raise HttpError(404, "cannot read a route's source: there is none at this cell")
        await socket.open(request)
        due = asyncio.Event()
        source = RouteSource(readable.route, due.set, is_drive=readable.is_drive)
        try:
            if isinstance(readable.source, App):
                source.follow(readable.source.read, readable.source.leave, readable.source.address)
            else:
                source.open(readable.source, self.shared_topics)
        except RobotetherError as problem:
            source.problem = problem.detail
        try:
            await run_until_first(self._send(socket, source, due, readable), listen(socket))
        finally:
            source.close(self.shared_topics)
        await socket.finish(close_reasons.client_left(readable.source.name))
        return socket

    async def _send(
        self,
        socket: OperatorSocket,
        source: RouteSource,
        due: asyncio.Event,
        readable: ReadableSource,
    ) -> None:
        """Send the newest message at the route's rate, and why none come, while the route may be read."""
        problem = ""
        while self.readable(readable.route.id) == readable:
            if source.problem != problem:
                problem = source.problem
                await socket.send_frame(problem.encode(), WSMsgType.TEXT)
            due_s = source.due_in_s(time.monotonic())
            if due_s is None:
                await wait_for_event(due, CHECK_EVERY_S)
            elif due_s or socket.waiting_bytes():
                await asyncio.sleep(min(max(due_s, LOOK_EVERY_S), CHECK_EVERY_S))
            else:
                await self._send_newest(socket, source)

    async def _send_newest(self, socket: OperatorSocket, source: RouteSource) -> None:
        now_s = time.monotonic()
        message = source.take(now_s)
        if message is None:
            return
        age_s = math.nan if message.since_s is None else now_s - message.since_s
        data = AGE.pack(age_s) + message.data
        await socket.send_message(data, WSMsgType.BINARY, self.piece_turns)


def _message_in(data: bytes, timestamps: CommandTimestamps) -> SourceMessage:
    """Read a message behind its age, which is added to the time that it took from the other cell at most."""
    (age_s,) = AGE.unpack_from(data)
    sent_s = timestamps.of(None, time.monotonic())
    if sent_s is None or not 0 <= age_s < math.inf:
        return SourceMessage(data[AGE.size :], None)
    return SourceMessage(data[AGE.size :], sent_s - age_s)
