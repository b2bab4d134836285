"""Round trips to a robot on any of the ways that are compared, idle and while somebody looks at its camera.

One machine, one clock. Every message that is sent is waited for; one that does not come back in time ends the
measurement, which is a failure of its step. Nothing here knows which way it is on (peer_way.py).
"""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from typing import Any

import aiohttp
from relay_server import until
from video_viewers import Frame

from paper.peer_transport import Transport

MESSAGE_BYTES, MESSAGE_TYPE = 200, "std_msgs/String"
RATE_HZ = 50
# The last message may be behind all that a link and its ends keep.
LAST_S = 20.0
FIRST_FRAME_WITHIN_S = 20.0
# A connection that is no longer needed may lead nowhere.
CLOSES_WITHIN_S = 0.1
_numbers = itertools.count(1)
Socket = aiohttp.ClientWebSocketResponse


@asynccontextmanager
async def http_of(transport: Transport) -> AsyncIterator[aiohttp.ClientSession]:
    """The operator's connections on this way; all are cut at the end."""
    async with aiohttp.ClientSession(connector=transport.connector()) as http:
        yield http


def connected(http: aiohttp.ClientSession, url: str) -> AbstractAsyncContextManager[Socket]:
    """A new rosbridge connection."""
    timeout = aiohttp.ClientWSTimeout(ws_close=CLOSES_WITHIN_S)
    return http.ws_connect(url, compress=0, max_msg_size=0, timeout=timeout)


def new_topic(what: str) -> str:
    """A topic that nobody else uses."""
    return f"/{what}_{os.getpid()}_{next(_numbers)}"


class Echo:
    """One connection that publishes a topic of its own and has it back from the robot."""

    def __init__(self, socket: Socket) -> None:
        self._socket = socket
        self._topic = new_topic("echo")
        self._sent_at: dict[int, float] = {}
        # In ms, by the message's number.
        self.round_trips_ms: dict[int, float] = {}
        # When the last message that came back was sent, on time.monotonic's clock.
        self.answered_of = float("-inf")

    async def begin(self) -> None:
        """Wait until a first message, number -1, has come back."""
        for op in ("advertise", "subscribe"):
            await self.send_topic(op, self._topic, MESSAGE_TYPE)
        # The robot takes them in order: the subscription is there before the message.
        await self.send(-1)
        await self.receive_until(-1)

    async def send_topic(self, op: str, topic: str, kind: str) -> None:
        """Advertise or subscribe."""
        await self._socket.send_json({"op": op, "topic": topic, "type": kind})

    async def send(self, number: int) -> None:
        """Publish one message of exactly MESSAGE_BYTES bytes."""
        empty = json.dumps({"op": "publish", "topic": self._topic, "msg": {"data": ""}})
        text = empty.replace('""', f'"{number:<{MESSAGE_BYTES - len(empty)}}"')
        self._sent_at[number] = time.monotonic()
        await self._socket.send_str(text)

    async def receive(self) -> None:
        """Take one message, of whatever kind."""
        text = await self._socket.receive_str()
        received_at = time.monotonic()
        said = json.loads(text)
        if said.get("op") == "publish" and said.get("topic") == self._topic:
            number = int(said["msg"]["data"])
            self.answered_of = self._sent_at[number]
            self.round_trips_ms[number] = (received_at - self.answered_of) * 1000

    async def receive_until(self, number: int) -> None:
        """Take messages until that one has come back."""
        while number not in self.round_trips_ms:
            await self.receive()


@asynccontextmanager
async def echoing(transport: Transport) -> AsyncIterator[Echo]:
    """A connection that has had a message back."""
    async with AsyncExitStack() as stack:
        async with asyncio.timeout(LAST_S):
            http = await stack.enter_async_context(http_of(transport))
            url = await asyncio.to_thread(transport.ros_url)
            echo = Echo(await stack.enter_async_context(connected(http, url)))
            await echo.begin()
        yield echo


async def round_trips(transport: Transport, seconds: float) -> list[float]:
    """Send a message each 1/RATE_HZ s without waiting for the one before; the round trips in ms, in order."""
    count = int(seconds * RATE_HZ)
    async with echoing(transport) as echo:
        receiving = asyncio.ensure_future(echo.receive_until(count - 1))
        try:
            started = time.monotonic()
            for number in range(count):
                await asyncio.sleep(max(0.0, started + number / RATE_HZ - time.monotonic()))
                await echo.send(number)
            await asyncio.wait_for(receiving, LAST_S)
        finally:
            await stop(receiving)
    # A KeyError is a message that was overtaken by the last, which is a loss here.
    return [echo.round_trips_ms[number] for number in range(count)]


async def behind_video(
    transport: Transport, video: str, seconds: float, settle_s: float
) -> dict[str, Any]:
    """Round trips while somebody looks at the camera, after so long, and how old the pictures are meanwhile."""
    seen: list[Frame] = []
    async with http_of(transport) as http:
        looking = asyncio.ensure_future(transport.view(http, video, seen.append))
        try:
            await until(
                lambda: seen or looking.done(),
                f"a picture: {transport.title}, {video}",
                FIRST_FRAME_WITHIN_S,
            )
            await asyncio.wait([looking], timeout=settle_s)
            seen.clear()
            started = time.monotonic()
            trips = await round_trips(transport, seconds)
            lasted_s = time.monotonic() - started
            # One whose picture ended meanwhile was not measured behind video.
            if looking.done():
                looking.result()
        finally:
            await stop(looking)
    if not seen:
        raise RuntimeError(f"cannot measure {transport.title} behind {video}: no picture came")
    return {"round_trips_ms": trips, **of_frames(seen, lasted_s)}


def of_frames(frames: Sequence[Frame], lasted_s: float) -> dict[str, Any]:
    """What those that came in so many seconds were like."""
    return {
        "picture_ages_ms": [frame.age_ms for frame in frames],
        "pictures_per_s": len(frames) / lasted_s,
        "picture_bytes": sum(len(frame.jpeg) for frame in frames) / len(frames),
    }


async def stop(task: asyncio.Future[None]) -> None:
    """Cancel it, and leave nothing of it."""
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
