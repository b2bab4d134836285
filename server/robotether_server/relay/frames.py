"""Answers /robots/NAME/video/frames: a camera's pictures over a WebSocket, by the viewer's credits.

What concerns ticket, origin or name is refused over HTTP; all that concerns the robot is told after the
upgrade, as a close code with a reason. What is due is written at once when nothing waits in this program,
and else when that is gone: the newest answer to a beat, the newest status, the newest picture.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import Coroutine
from typing import Any

from aiohttp import WSMsgType, web

from robotether_server.problems import HttpProblem
from robotether_server.relay import endings
from robotether_server.relay.access import Permit, request_of
from robotether_server.relay.allowance import Allowance
from robotether_server.relay.endings import EndedError, Ending
from robotether_server.relay.feeds import Feed
from robotether_server.relay.liveness import Limits, Liveness
from robotether_server.relay.means import Means
from robotether_server.relay.pictures import (
    MAX_CREDITS,
    MAX_TEXT_BYTES,
    BrokenFramesError,
    Want,
    parse_beat,
    parse_credit,
    parse_text,
    parse_want,
    text_frame,
)
from robotether_server.relay.sessions import utc_now
from robotether_server.relay.sockets import ViewerSocket
from robotether_server.relay.viewers import Cursor, connection_of, counted, topic_of

log = logging.getLogger(__name__)

# Two texts a picture at 60 pictures a second, and some.
MESSAGES_PER_S = 200
MESSAGES_AT_ONCE = 400


class FramesHandler:
    """Answers /robots/NAME/video/frames."""

    def __init__(self, means: Means, limits: Limits) -> None:
        self._means = means
        self._limits = limits

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Show one camera to one viewer until one of them ends."""
        if not web.WebSocketResponse().can_prepare(request):
            raise HttpProblem(426, "cannot open frames: connect with a WebSocket")
        topic = topic_of(request)
        asked = request_of(request.headers, request.cookies, request.query)
        permit = await self._means.access.for_frames(asked, request.match_info["name"])
        socket = ViewerSocket(MAX_TEXT_BYTES)
        visit = FramesVisit(socket, permit, self._means, self._limits)
        connection = connection_of(permit, topic, visit.end)
        if (why := self._means.connections.no_room(connection)) is not None:
            visit.end(endings.too_many_connections(why))
        # Before anything waits: a right that ends in the meantime must end this connection.
        with counted(self._means, permit, connection):
            await socket.open(request)
            ending = await visit.run(topic)
        await socket.finish(ending)
        return socket


class FramesVisit:
    """One viewer of one camera, from the upgrade to the end."""

    def __init__(self, socket: ViewerSocket, permit: Permit, means: Means, limits: Limits) -> None:
        self._socket = socket
        self._permit = permit
        self._name = permit.robot.name
        self._means = means
        self._limits = limits
        loop = asyncio.get_running_loop()
        self._ended: asyncio.Future[Ending] = loop.create_future()
        self._heard_s = time.monotonic()
        self._allowance = Allowance(self._heard_s, per_s=MESSAGES_PER_S, at_once=MESSAGES_AT_ONCE)
        self.want: Want | None = None
        self._credits = 0
        # Numbers of pictures that were sent and not yet taken.
        self._under_way: deque[int] = deque(maxlen=MAX_CREDITS)
        self._beat_ms: float | None = None
        self._told: dict[str, object] | None = None
        self._written = 0
        self._blocked = asyncio.Event()
        # From `run` on.
        self._feed: Feed
        self._cursor: Cursor

    def end(self, ending: Ending) -> None:
        """End the connection at once; the first ending counts."""
        if not self._ended.done():
            self._ended.set_result(ending)

    def news(self) -> None:
        """The feed has something new."""
        self._push()

    async def run(self, topic: str) -> Ending:
        """Show the camera; return why that ended."""
        robot, user = self._permit.robot, self._permit.user
        presence = self._means.registry.presence(robot.id)
        if not presence.online:
            self.end(endings.robot_offline(robot.name, presence.since, utc_now()))
        if self._ended.done():
            return self._ended.result()
        with (
            self._means.feeds.followed(robot, topic, self) as self._feed,
            self._means.deliveries.viewing(robot.id, user.id),
        ):
            self._cursor = Cursor(self._feed, time.monotonic())
            work = asyncio.create_task(self._guard(self._work()), name=f"frames of {robot.name}")
            try:
                return await self._ended
            finally:
                work.cancel()
                await asyncio.gather(work, return_exceptions=True)

    async def _guard(self, part: Coroutine[Any, Any, Ending]) -> None:
        """Run a part of the connection; its end, or its defect, ends the connection."""
        try:
            self.end(await part)
        except EndedError as exc:
            self.end(exc.ending)
        except ConnectionError:
            self.end(endings.client_vanished(self._name))
        except Exception:
            log.exception("robot %s: a viewer's connection failed", self._name)
            self.end(endings.relay_failed())

    async def _work(self) -> Ending:
        async with asyncio.TaskGroup() as group:
            for part in (self._read(), self._push_again(), self._watch(), self._ping()):
                group.create_task(self._guard(part))
        return await self._ended

    async def _read(self) -> Ending:
        while True:
            message = await self._socket.receive()
            self._heard_s = time.monotonic()
            if not self._allowance.take(self._heard_s):
                return endings.frames_broken(f"more than {MESSAGES_PER_S} messages a second")
            if message.type is WSMsgType.TEXT:
                self._hear(message.data)
            elif message.type is WSMsgType.PING:
                await self._socket.pong(message.data)
            elif message.type is WSMsgType.CLOSE:
                return endings.client_left(self._name)
            elif message.type is WSMsgType.ERROR:
                return endings.frames_broken("a message is over 4 KiB, or no WebSocket")
            elif message.type in {WSMsgType.CLOSING, WSMsgType.CLOSED}:
                return endings.client_vanished(self._name)

    def _hear(self, data: bytes) -> None:
        try:
            self._take(parse_text(data))
        except BrokenFramesError as exc:
            raise EndedError(endings.frames_broken(str(exc))) from exc
        self._push()

    def _take(self, message: dict[str, Any]) -> None:
        operation = message["op"]
        if operation == "credit":
            self._take_credit(*parse_credit(message))
        elif operation == "beat":
            self._beat_ms = parse_beat(message)
        elif operation == "want":
            self.want = parse_want(message)
            self._feed.due.set()

    def _take_credit(self, frames: int, taken: int | None) -> None:
        if self.want is None:
            raise BrokenFramesError("want comes before credit")
        self._credits = min(self._credits + frames, MAX_CREDITS)
        if taken is None and self._under_way:
            # A client that does not say which.
            taken = self._under_way[min(frames, len(self._under_way)) - 1]
        if taken is not None and taken in self._under_way:
            while self._under_way.popleft() != taken:
                pass
            self._feed.taken(taken)

    def _push(self) -> None:
        """Write what is due, unless something still waits in this program: then it would wait, too."""
        while not self._socket.waiting_bytes():
            frame = self._next_frame()
            if frame is None:
                return
            self._written += len(frame)
            self._socket.write_frame(frame)
        self._blocked.set()

    async def _push_again(self) -> Ending:
        while True:
            await self._blocked.wait()
            self._blocked.clear()
            await self._socket.drained()
            self._push()

    def _next_frame(self) -> bytes | None:
        if self._ended.done():
            return None
        if self._beat_ms is not None:
            t_ms, self._beat_ms = self._beat_ms, None
            sender_ms = round(time.monotonic() * 1000, 3)
            return text_frame({"op": "beat", "t_ms": t_ms, "sender_ms": sender_ms})
        if self._feed.status is not None and self._feed.status is not self._told:
            self._told = self._feed.status
            return text_frame(self._told)
        return self._next_picture()

    def _next_picture(self) -> bytes | None:
        picture = self._cursor.next() if self._credits else None
        if picture is None:
            return None
        self._credits -= 1
        self._under_way.append(picture.number)
        self._cursor.sent(picture)
        self._means.deliveries.count(self._permit.robot.id, self._permit.user.id, picture.size)
        return picture.frame

    async def _watch(self) -> Ending:
        limits = self._limits
        liveness = Liveness(limits, time.monotonic())
        while True:
            await asyncio.sleep(limits.look_every_s)
            verdict = liveness.look(
                time.monotonic(),
                heard_at=self._heard_s,
                to_client=(self._written, self._socket.waiting_bytes()),
                to_robot=(0, 0),
            )
            if verdict == "client_silent":
                return endings.client_silent(self._name, limits.silent_after_s)
            if verdict == "client_slow":
                return endings.client_slow(self._name, limits.slow_after_s)

    async def _ping(self) -> Ending:
        while True:
            await asyncio.sleep(self._limits.ping_every_s)
            # Behind data that waits a ping would only wait too.
            if not self._socket.waiting_bytes():
                await self._socket.ping()
