"""Answers /robots/NAME/video/frames: a camera's frames over a WebSocket, by the viewer's credits.

Problems with ticket, origin or name are HTTP errors; those of the robot are reported after the upgrade, as a close code
with a reason. Once nothing waits in this program, it writes what is due: the newest answer to a clock sync, the newest
status, the next frame.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from dataclasses import asdict, dataclass, replace
from typing import Any

from aiohttp import WSMsgType, web
from robotether_common.frames import MAX_CREDITS, MAX_TEXT_BYTES, StreamRequest, VideoStatus

from robotether_server.db.fleet import RECORDER
from robotether_server.problems import HttpError, ProtocolError
from robotether_server.relay.auth.access import Permit, request_of
from robotether_server.relay.channels.video.frame_protocol import (
    parse_clock_sync,
    parse_credit,
    parse_stream_request,
    parse_text,
    write_message,
)
from robotether_server.relay.channels.video.viewers import (
    Cursor,
    VideoContext,
    ViewerPlace,
    connection_of,
    counted,
    note_sent,
    topic_of,
)
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason, ConnectionClosedError
from robotether_server.relay.http.sockets import ClientConnection, ViewerSocket
from robotether_server.relay.http.timing import LivenessLimits, RateLimiter

# Maximum rate of messages: two texts per frame at 60 frames a second, and a margin.
MESSAGES_PER_S = 200
MESSAGES_AT_ONCE = 400


# Time for which a frame that the recorder has taken waits for the operators, who set the robot's pace: a page that is
# hidden takes none.
RECORDER_WAITS_S = 0.5


@dataclass(frozen=True)
class FramesHandler:
    """Answers /robots/NAME/video/frames."""

    context: VideoContext
    limits: LivenessLimits

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Show one camera to one viewer until one of them ends."""
        if not web.WebSocketResponse().can_prepare(request):
            raise HttpError(426, "cannot open frames: connect with a WebSocket")
        topic = topic_of(request)
        permit = await self.context.access.for_frames(
            request_of(request), request.match_info["name"]
        )
        socket = ViewerSocket(MAX_TEXT_BYTES)
        session = FramesSession(socket, permit, topic, self.context, self.limits)
        connection = connection_of(permit, topic, session.end)
        if (why := self.context.connections.no_room(connection)) is not None:
            session.end(close_reasons.too_many_connections(why))
        # Before anything waits: a right that ends in the meantime must end this connection.
        with counted(self.context, permit, connection):
            await socket.open(request)
            close_reason = await session.run()
        await socket.finish(close_reason)
        return socket


class FramesSession(ClientConnection):
    """One viewer of one camera, from the upgrade to the end."""

    _socket: ViewerSocket

    def __init__(
        self,
        socket: ViewerSocket,
        permit: Permit,
        camera: str,
        context: VideoContext,
        limits: LivenessLimits,
    ) -> None:
        super().__init__(permit.robot.name, socket, limits)
        self._permit = permit
        self.is_recorder, self.may_drive = permit.user.id == RECORDER.id, permit.may_drive
        self._camera = camera
        self._context = context
        self._limiter = RateLimiter(
            self._received_s, per_s=MESSAGES_PER_S, at_once=MESSAGES_AT_ONCE
        )
        self.stream_request: StreamRequest | None = None
        self._credits = 0
        # Numbers of frames that were sent and not yet taken, and when each was sent.
        self._under_way: deque[tuple[int, float]] = deque(maxlen=MAX_CREDITS)
        self.round_trip_s = 0.0
        self._clock_sync_ms: float | None = None
        self._sent_status: VideoStatus | None = None
        self._blocked = asyncio.Event()
        # From the first stream request on, which says what the viewer decodes.
        self._place: ViewerPlace | None = None

    def user_ids(self) -> tuple[int]:
        """Return whose it is."""
        return (self._permit.user.id,)

    def notify(self) -> None:
        """The feed has something new."""
        self._follow()
        self._push()

    async def run(self) -> CloseReason:
        """Show the camera; return why that ended."""
        robot, user = self._permit.robot, self._permit.user
        if self._ended.done():
            return self._ended.result()
        with self._context.registry.ensure_robot(robot.id).viewer_stats.viewing(user.id):
            try:
                return await self._run_until_ended(self._work())
            finally:
                if self._place is not None:
                    self._place.leave()

    def _follow(self) -> None:
        """Follow the feed that is the viewer's now."""
        if self._ended.done():
            return
        if self._place is None:
            self._place = ViewerPlace(self._context.feeds, self._permit.robot, self._camera, self)
        elif self._place.move():
            self._under_way.clear()

    async def _work(self) -> CloseReason:
        self._context.registry.online_presence(self._permit.robot)
        return await self._run_together(self._read(), self._push_again())

    async def _read(self) -> CloseReason:
        while True:
            message = await self._receive()
            if not self._limiter.allow(self._received_s):
                return close_reasons.frames_broken(f"more than {MESSAGES_PER_S} messages a second")
            if message.type is WSMsgType.TEXT:
                self._on_text(message.data)
            elif message.type is WSMsgType.PING:
                await self._socket.pong(message.data)
            elif message.type is WSMsgType.CLOSE:
                return close_reasons.client_left(self.name)
            elif message.type is WSMsgType.ERROR:
                return close_reasons.frames_broken("a message is over 4 KiB, or no WebSocket")
            elif message.type in {WSMsgType.CLOSING, WSMsgType.CLOSED}:
                return close_reasons.client_vanished(self.name)

    def _on_text(self, data: bytes) -> None:
        try:
            self._handle(parse_text(data))
        except ProtocolError as exc:
            raise ConnectionClosedError(close_reasons.frames_broken(str(exc))) from exc
        self._push()

    def _handle(self, message: dict[str, Any]) -> None:
        operation = message["op"]
        if operation == "credit":
            self._on_credit(*parse_credit(message))
        elif operation == "clock_sync":
            self._clock_sync_ms = parse_clock_sync(message)
        elif operation == "stream_request":
            request = parse_stream_request(message)
            # An observer takes no rate from a driver.
            self.stream_request = request if self.may_drive else replace(request, prefers=None)
            self._follow()
            if self._place is not None:
                self._place.feed.due.set()
        elif operation == "key_frame" and self._place is not None:
            if self.is_recorder:
                # A reader of the file needs one; the recorder itself goes on with what comes until then.
                self._place.feed.request_key_frame()
            else:
                self._place.cursor.restart()

    def _on_credit(self, frames: int, sequence: int | None) -> None:
        if self._place is None:
            raise ProtocolError("stream_request comes before credit")
        feed = self._place.feed
        self._credits = min(self._credits + frames, MAX_CREDITS)
        if sequence is None and self._under_way:
            # A client that does not say which.
            sequence = self._under_way[min(frames, len(self._under_way)) - 1][0]
        if sequence is not None and self._note_taken(sequence):
            if self.is_recorder and feed.has_operators:
                # Whose line is slow must not get frames for a quicker one.
                loop = asyncio.get_running_loop()
                loop.call_later(RECORDER_WAITS_S, feed.taken, sequence)
            else:
                feed.taken(sequence)

    def _note_taken(self, sequence: int) -> bool:
        """Note that the viewer has this frame and those before; return whether it was sent and not yet taken."""
        if all(sent != sequence for sent, _ in self._under_way):
            return False
        sent, sent_s = self._under_way.popleft()
        while sent != sequence:
            sent, sent_s = self._under_way.popleft()
        took_s = time.monotonic() - sent_s
        self.round_trip_s = min(self.round_trip_s or took_s, took_s)
        return True

    def _push(self) -> None:
        """Write what is due, unless something still waits in this program: then it would wait, too."""
        while not self._socket.waiting_bytes():
            message = self._next_message()
            if message is None:
                return
            self._bytes_to_client += len(message)
            self._socket.write_message(message)
        self._blocked.set()

    async def _push_again(self) -> CloseReason:
        while True:
            await self._blocked.wait()
            self._blocked.clear()
            await self._socket.drained()
            self._push()

    def _next_message(self) -> bytes | None:
        if self._ended.done():
            return None
        if self._clock_sync_ms is not None:
            t_ms, self._clock_sync_ms = self._clock_sync_ms, None
            sender_ms = round(time.monotonic() * 1000, 3)
            return write_message("clock_sync", t_ms=t_ms, sender_ms=sender_ms)
        if self._place is None:
            return None
        status = self._place.feed.status
        if status is not None and status is not self._sent_status:
            self._sent_status = status
            return write_message("status", **asdict(status))
        return self._next_frame(self._place.cursor)

    def _next_frame(self, cursor: Cursor) -> bytes | None:
        frame = cursor.next() if self._credits else None
        if frame is None:
            return None
        self._credits -= 1
        self._under_way.append((frame.sequence, time.monotonic()))
        cursor.sent(frame)
        note_sent(self._context, self._permit, self._camera, frame)
        return frame.message
