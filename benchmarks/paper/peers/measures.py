"""What is measured on any of the ways that are compared; nothing here knows which one it is.

Round trips, idle and while somebody looks at the camera: every message that is sent is waited for, and one that does
not come back in time is a failure of its step. Throughput and its processor time: a program on the robot publishes as
the operator asks for it, so much at a time that the link never waits and no queue on the way runs over. Starts and new
addresses: nobody's protocol is asked whether it is connected; an operator's program tries again and again to have the
robot's odometry on a new connection, side by side with the attempts before, and the first message that came counts.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import random
import time
from collections.abc import AsyncIterator, Coroutine, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager, suppress
from typing import Any

import aiohttp
from relay_server import until
from video_viewers import Frame

from paper.client import new_http
from paper.networks import made_in
from paper.peers.transports import OBSERVE, Transport

MESSAGE_BYTES, MESSAGE_TYPE = 200, "std_msgs/String"
RATE_HZ = 50
# The last message may be behind all that a link and its ends keep.
LAST_S = 20.0
FIRST_FRAME_WITHIN_S = 20.0
# A connection that is no longer needed may lead nowhere.
CLOSES_WITHIN_S = 0.1
_numbers = itertools.count(1)
Socket = aiohttp.ClientWebSocketResponse
# More than the link and the queue before it hold.
LOAD_BYTES, LOADS_AT_ONCE = 48 * 1024, 12
# How often a new attempt begins, how long one lasts, and after which time it counts as never.
EVERY_S, ATTEMPT_S, GIVE_UP_S = 0.2, 1.0, 60.0
# Of an operator who gives a tunnel time to notice.
PATIENT_EVERY_S, PATIENT_GIVE_UP_S = 15.0, 180.0
HELD_HZ, POLL_EVERY_S = 20, 0.01
TELEMETRY, TELEMETRY_TYPE = "/odom", "nav_msgs/Odometry"


@asynccontextmanager
async def http_of(transport: Transport) -> AsyncIterator[aiohttp.ClientSession]:
    """The operator's connections on this way; all are cut at the end."""
    async with transport.http() as http:
        yield http


def connected(http: aiohttp.ClientSession, url: str) -> AbstractAsyncContextManager[Socket]:
    timeout = aiohttp.ClientWSTimeout(ws_close=CLOSES_WITHIN_S)
    return http.ws_connect(url, compress=0, max_msg_size=0, timeout=timeout)


def new_topic(what: str) -> str:
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
        await self._socket.send_json({"op": op, "topic": topic, "type": kind})

    async def send(self, number: int) -> None:
        empty = json.dumps({"op": "publish", "topic": self._topic, "msg": {"data": ""}})
        text = empty.replace('""', f'"{number:<{MESSAGE_BYTES - len(empty)}}"')
        self._sent_at[number] = time.monotonic()
        await self._socket.send_str(text)

    async def receive(self) -> None:
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
    """Round trips while somebody looks at the camera, after so long, and how old the frames are meanwhile."""
    seen: list[Frame] = []
    async with http_of(transport) as http:
        looking = asyncio.ensure_future(transport.view(http, video, seen.append))
        try:
            await until(
                lambda: seen or looking.done(),
                f"a frame: {transport.title}, {video}",
                FIRST_FRAME_WITHIN_S,
            )
            await asyncio.wait([looking], timeout=settle_s)
            seen.clear()
            started = time.monotonic()
            trips = await round_trips(transport, seconds)
            lasted_s = time.monotonic() - started
            # One whose frame ended meanwhile was not measured behind video.
            if looking.done():
                looking.result()
        finally:
            await stop(looking)
    if not seen:
        raise RuntimeError(f"cannot measure {transport.title} behind {video}: no frame came")
    return {"round_trips_ms": trips, **of_frames(seen, lasted_s)}


def of_frames(frames: Sequence[Frame], lasted_s: float) -> dict[str, Any]:
    """What those that came in so many seconds were like."""
    return {
        "picture_ages_ms": [frame.age_ms for frame in frames],
        "pictures_per_s": len(frames) / lasted_s,
        "picture_bytes": sum(len(frame.jpeg) for frame in frames) / len(frames),
    }


async def stop(task: asyncio.Future[None]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


class Load:
    """The program on the robot, and the operator who asks; they run inside `async with`."""

    def __init__(self, robot: Socket, operator: Socket) -> None:
        self._more, self._load = new_topic("more"), new_topic("load")
        self._robot, self._operator = robot, operator
        # What no compression on the way makes much smaller.
        self._data = random.Random(1).randbytes(LOAD_BYTES // 2).hex()
        self.received_bytes = 0

    async def __aenter__(self) -> Load:
        ends = ((self._robot, self._load, self._more), (self._operator, self._more, self._load))
        for socket, out, into in ends:
            await socket.send_json({"op": "advertise", "topic": out, "type": MESSAGE_TYPE})
            await socket.send_json({"op": "subscribe", "topic": into, "type": MESSAGE_TYPE})
        self._tasks = [asyncio.ensure_future(one) for one in (self._publish(), self._ask())]
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in self._tasks:
            await stop(task)

    def check(self) -> None:
        for task in self._tasks:
            if task.done():
                task.result()

    async def _publish(self) -> None:
        text = json.dumps({"op": "publish", "topic": self._load, "msg": {"data": self._data}})
        while True:
            await self._robot.receive_str()
            await self._robot.send_str(text)

    async def _ask(self) -> None:
        more = {"op": "publish", "topic": self._more, "msg": {"data": ""}}
        for _ in range(LOADS_AT_ONCE):
            await self._operator.send_json(more)
        while True:
            text = await self._operator.receive_str()
            if len(text) > LOAD_BYTES:
                self.received_bytes += len(text)
                await self._operator.send_json(more)


async def throughput(transport: Transport, seconds: float, settle_s: float) -> dict[str, float]:
    """Payload in bit/s that comes from the robot, and processor seconds a MB of it at the robot's and server's side."""
    async with AsyncExitStack() as stack:
        http = await stack.enter_async_context(http_of(transport))
        local = new_http(force_close=True, **made_in(transport.inside))
        await stack.enter_async_context(local)
        url = await asyncio.to_thread(transport.ros_url)
        operator = await stack.enter_async_context(connected(http, url))
        robot = await stack.enter_async_context(connected(local, transport.local_ros_url()))
        load = await stack.enter_async_context(Load(robot, operator))
        await until(lambda: load.received_bytes or load.check(), f"load, {transport.title}", LAST_S)
        await asyncio.sleep(settle_s)
        before = await asyncio.to_thread(costs, transport)
        started, received = time.monotonic(), load.received_bytes
        await asyncio.sleep(seconds)
        lasted_s, carried = time.monotonic() - started, load.received_bytes - received
        after = await asyncio.to_thread(costs, transport)
        load.check()
    return {"payload_bit_s": carried * 8 / lasted_s, **per_mb(before, after, carried)}


def costs(transport: Transport) -> tuple[float, float]:
    """Processor seconds so far of the robot's and the server's side."""
    return transport.robot_cpu_s(), transport.server_cpu_s()


def per_mb(
    before: tuple[float, float], after: tuple[float, float], carried_bytes: int
) -> dict[str, float]:
    """What was spent between two looks, for each 10^6 bytes."""
    robot, server = (last - first for first, last in zip(before, after, strict=True))
    mb = carried_bytes / 1e6
    return {"robot_cpu_s_per_mb": robot / mb, "server_cpu_s_per_mb": server / mb}


async def connect_s(transport: Transport) -> float | None:
    """Seconds from the start of the robot's client program to the first message from it; None: never."""
    since = time.monotonic()
    await asyncio.to_thread(transport.connect)
    return await first_message_s(transport, since)


async def first_message_s(
    transport: Transport, since: float, every_s: float = EVERY_S, give_up_s: float = GIVE_UP_S
) -> float | None:
    """Seconds from `since` until a message has come on a new connection; one is tried each `every_s`."""
    first: asyncio.Future[float] = asyncio.get_running_loop().create_future()
    attempts = []
    try:
        while time.monotonic() < since + give_up_s:
            attempts.append(asyncio.ensure_future(_attempt(transport, first)))
            await asyncio.wait([first], timeout=every_s)
            if first.done():
                return first.result() - since
            transport.check()
        return None
    finally:
        for attempt in attempts:
            await stop(attempt)


async def _attempt(transport: Transport, first: asyncio.Future[float]) -> None:
    """Try once, and tell `first` the moment of the message."""
    with suppress(aiohttp.ClientError, OSError, TimeoutError, TypeError):
        async with asyncio.timeout(ATTEMPT_S), http_of(transport) as http:
            url = await asyncio.to_thread(transport.ros_url, OBSERVE)
            async with connected(http, url) as socket:
                wanted = {"op": "subscribe", "topic": TELEMETRY, "type": TELEMETRY_TYPE}
                await socket.send_json(wanted)
                while '"publish"' not in await socket.receive_str():
                    pass
                if not first.done():
                    first.set_result(time.monotonic())


async def recover_s(transport: Transport, after_s: float) -> float | None:
    """Seconds from the robot's new address until a message passes, on the connection that was there or on a new one.

    The connection has stood for `after_s`, with messages both ways all the time; None: never.
    """
    async with echoing(transport) as held:
        # What a robot says by itself shows some ways where it is now.
        await held.send_topic("subscribe", TELEMETRY, TELEMETRY_TYPE)
        holding = asyncio.ensure_future(_hold(held))
        try:
            await asyncio.wait([holding], timeout=after_s)
            if holding.done():
                holding.result()
            await asyncio.to_thread(transport.readdress)
            since = time.monotonic()
            return await _first(
                _held_answer_s(held, holding, since), first_message_s(transport, since)
            )
        finally:
            await stop(holding)


async def recover_patiently_s(transport: Transport) -> float | None:
    """As recover_s, with an operator whose connections are closed, and who tries each PATIENT_EVERY_S only."""
    await asyncio.to_thread(transport.readdress)
    since = time.monotonic()
    await asyncio.sleep(PATIENT_EVERY_S)
    return await first_message_s(transport, since, PATIENT_EVERY_S, PATIENT_GIVE_UP_S)


async def _hold(held: Echo) -> None:
    """Send and take messages until the connection ends."""
    taking = asyncio.ensure_future(_receive(held))
    try:
        number = 0
        while not taking.done():
            await held.send(number)
            number += 1
            await asyncio.wait([taking], timeout=1 / HELD_HZ)
        taking.result()
    finally:
        await stop(taking)


async def _receive(held: Echo) -> None:
    while True:
        await held.receive()


async def _held_answer_s(held: Echo, holding: asyncio.Future[None], since: float) -> float | None:
    """Seconds until a message that was sent after `since` has come back; None when the connection ended, or never."""
    while held.answered_of < since:
        if holding.done() or time.monotonic() > since + GIVE_UP_S:
            return None
        await asyncio.sleep(POLL_EVERY_S)
    return time.monotonic() - since


async def _first(*transports: Coroutine[None, None, float | None]) -> float | None:
    """What the first of these gives that gives something; the others are ended."""
    tasks = [asyncio.ensure_future(transport) for transport in transports]
    try:
        for done in asyncio.as_completed(tasks):
            if (took_s := await done) is not None:
                return took_s
        return None
    finally:
        for task in tasks:
            await stop(task)
