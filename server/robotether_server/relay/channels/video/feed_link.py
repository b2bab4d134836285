"""The WebSocket to a robot's frames service, from which one feed gets its frames.

`feeds` runs one a feed. It opens the connection, opens it again when it breaks while the robot is there, asks for the
robot's clock, and sends the robot what the feed requests and has received.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from dataclasses import asdict

from aiohttp import WSMsgType
from robotether_common.frames import (
    HEADER,
    KEY_FRAME_EVERY_S,
    MAX_FRAME_BYTES,
    PATH,
    StreamRequest,
    VideoStatus,
)

from robotether_server.problems import ProtocolError
from robotether_server.relay.channels.video.feeds import Feed
from robotether_server.relay.channels.video.frame_protocol import (
    SenderClock,
    parse_clock_sync_answer,
    parse_status,
    parse_text,
    write_text,
)
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason, ConnectionClosedError
from robotether_server.relay.http.sockets import RobotSocket
from robotether_server.relay.http.timing import RateLimiter
from robotether_server.relay.robots.demand import OPENS_WITHIN_S
from robotether_server.relay.robots.media_dialer import MediaDialer, MediaPath
from robotether_server.tasks import end_tasks, wait_for_event
from robotether_server.times import delays

log = logging.getLogger(__name__)

AGAIN_WITHIN_S = 10.0
FIRST_PAUSE_S = 0.2
# Time after which a connection counts as stable.
STEADY_S = 10.0
CLOCK_SYNC_EVERY_S = 1.0
# Time without data after which a connection counts as lost; clock syncs are sent all the time.
SILENT_AFTER_S = 8.0
# Minimum interval between stream requests: viewers come together, and one may change its request
# with a slider.
REQUEST_EVERY_S = 0.1
# Maximum rate of messages besides frames: an answer to each clock sync, a status at each change,
# and a margin. Reading without a limit would starve the others.
MESSAGES_PER_S = 50
MESSAGES_AT_ONCE = 100
LINK_BROKE = "the robot's video connection broke; trying again"


async def bring_frames(dialer: MediaDialer, feed: Feed) -> CloseReason:
    """Bring a feed its frames until there is no way to the robot; return why."""
    return await FeedLink(feed, dialer).run()


class FeedLink:
    """Brings one feed its frames."""

    def __init__(self, feed: Feed, dialer: MediaDialer) -> None:
        self._feed = feed
        self._dialer = dialer
        self._clock = SenderClock()
        self._received_s = 0.0

    async def run(self) -> CloseReason:
        """Bring frames until there is no way to the robot; return why."""
        within_s, pauses = OPENS_WITHIN_S, delays(FIRST_PAUSE_S)
        while True:
            try:
                socket = await self._dial(within_s)
            except ConnectionClosedError as exc:
                return exc.close_reason
            opened_s = time.monotonic()
            try:
                await self._listen(socket)
            finally:
                socket.drop()
            self._feed.on_status(VideoStatus("down", LINK_BROKE))
            within_s = AGAIN_WITHIN_S
            if time.monotonic() - opened_s > STEADY_S:
                pauses = delays(FIRST_PAUSE_S)
            await pause(next(pauses))

    async def _listen(self, socket: RobotSocket) -> None:
        """Pass on what comes until the connection breaks."""
        name = self._feed.robot.name
        self._clock, self._received_s = SenderClock(), time.monotonic()
        self._feed.on_connected()
        sending = asyncio.create_task(self._send_due(socket), name=f"feed {name} sends")
        uplink = self._dialer.registry.ensure_robot(self._feed.robot.id).uplink
        received, user_ids = socket.received_bytes, self._feed.user_ids
        try:
            with uplink.counted("camera", self._feed.key.camera, received, user_ids):
                await self._read(socket)
            log.info("robot %s: the connection of a feed broke", name)
        except ConnectionError as exc:
            log.info("robot %s: the connection of a feed broke: %r", name, exc)
        except ProtocolError as exc:
            log.warning("robot %s: broke the frames protocol: %s", name, exc)
        finally:
            await end_tasks([sending])

    async def _read(self, socket: RobotSocket) -> None:
        now_s = time.monotonic()
        limiter = RateLimiter(now_s, per_s=MESSAGES_PER_S, at_once=MESSAGES_AT_ONCE)

        def on_other(_kind: WSMsgType, _payload: bytes = b"") -> None:
            self._received_s = time.monotonic()
            if not limiter.allow(self._received_s):
                raise ProtocolError(f"more than {MESSAGES_PER_S} messages a second")

        while True:
            message = await socket.next_message(on_other)
            if message.type is WSMsgType.BINARY:
                self._received_s = now_s = time.monotonic()
                self._feed.on_frame(message.data, now_s, self._clock)
            elif message.type is WSMsgType.TEXT:
                on_other(message.type)
                self._on_text(message.data, self._received_s)
            else:
                return

    def _on_text(self, data: bytes, now_s: float) -> None:
        message = parse_text(data)
        if message["op"] == "clock_sync":
            self._clock.on_answer(now_s, *parse_clock_sync_answer(message))
        elif message["op"] == "status":
            self._feed.on_status(parse_status(message))

    async def _send_due(self, socket: RobotSocket) -> None:
        """Send what is due; drop a connection on which nothing comes."""
        sender = FeedSender(self._feed, socket)
        try:
            while (now_s := time.monotonic()) - self._received_s <= SILENT_AFTER_S:
                hurries = await sender.send_due(now_s)
                within_s = REQUEST_EVERY_S if hurries else CLOCK_SYNC_EVERY_S
                await wait_for_event(self._feed.due, within_s)
        except ConnectionError:
            log.debug("robot %s: a feed's connection does not take anything", self._feed.robot.name)
        socket.drop()

    async def _dial(self, within_s: float) -> RobotSocket:
        robot = self._feed.robot
        frames = MediaPath(
            PATH,
            {"topic": self._feed.key.camera},
            HEADER.size + MAX_FRAME_BYTES,
            close_reasons.frames_unknown(robot.name),
            close_reasons.video_down,
        )
        return await self._dialer.open(robot, frames, within_s)


class FeedSender:
    """Sends the robot what is due on one connection: stream and key frame requests, credits and clock syncs."""

    def __init__(self, feed: Feed, socket: RobotSocket) -> None:
        self._feed = feed
        self._socket = socket
        self._sent_request: StreamRequest | None = None
        self._requested_s = self._key_requested_s = self._synced_s = -math.inf

    async def send_due(self, now_s: float) -> bool:
        """Send what is due now, and return whether a request waits because another one was sent just before.

        ConnectionError when the robot takes nothing.
        """
        # Before the first credit: a frame whose timestamp nobody can convert is of no use.
        if now_s - self._synced_s >= CLOCK_SYNC_EVERY_S:
            self._synced_s = now_s
            await self._send("clock_sync", t_ms=now_s * 1000)
        request = self._feed.stream_request()
        await self._send_request(request, now_s)
        if self._sent_request is None:
            return request is not None
        if self._feed.needs_key_frame and now_s - self._key_requested_s >= KEY_FRAME_EVERY_S:
            self._feed.needs_key_frame, self._key_requested_s = False, now_s
            await self._send("key_frame")
        if (credit := self._feed.credit()) is not None:
            frames, sequence = credit
            await self._send("credit", frames=frames, taken=sequence)
        return request is not None and (request != self._sent_request or self._feed.needs_key_frame)

    async def _send_request(self, request: StreamRequest | None, now_s: float) -> None:
        if request is None or request == self._sent_request:
            return
        if now_s - self._requested_s < REQUEST_EVERY_S:
            return
        self._sent_request, self._requested_s = request, now_s
        await self._send("stream_request", **asdict(request))

    async def _send(self, op: str, **members: object) -> None:
        await self._socket.send_frame(write_text(op, **members), WSMsgType.TEXT)


async def pause(pause_s: float) -> None:
    """Wait before the next connection; tests look at how long."""
    await asyncio.sleep(pause_s)
