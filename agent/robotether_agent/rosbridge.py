"""The agent's own use of rosbridge: asks rosapi, and subscribes to a topic.

Used for video and battery, each on a connection of its own and only while somebody wants what it brings.
Never publishes, and never calls anything but rosapi's look-ups. Messages of a connection are read by one task alone.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any, cast

import aiohttp

from robotether_agent.fields import FieldError, JsonObject, parse_object
from robotether_agent.tasks import within

CONNECT_WITHIN_S = 3.0
ANSWER_WITHIN_S = 3.0
HEARTBEAT_S = 10.0
CLOSE_WITHIN_S = 0.5
CALL_ID = "robotether_agent:call"
LOOK_UP_ID = "robotether_agent:topics"
LOOK_UP = {"op": "call_service", "id": LOOK_UP_ID, "service": "/rosapi/topics", "args": {}}
IMAGE_TYPE = "sensor_msgs/CompressedImage"
# Whatever takes one of these may be another robot.
DRIVE_TYPES = (
    "geometry_msgs/Twist",
    "geometry_msgs/TwistStamped",
    "ackermann_msgs/AckermannDriveStamped",
)
# Maximum size of an answer: the list of all topics of a large robot.
MAX_ANSWER_BYTES = 1024 * 1024


class Rosbridge:
    """One connection."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket = socket

    async def call(self, service: str, args: Mapping[str, object]) -> JsonObject:
        """Return what a service answers, nothing if it refuses. On a connection without subscriptions only."""
        call = {"op": "call_service", "id": CALL_ID, "service": service, "args": args}
        await self._socket.send_json(call)
        while True:
            operation = await self._operation()
            if operation.get("op") == "service_response" and operation.get("id") == CALL_ID:
                values = operation.get("values")
                return cast("JsonObject", values) if isinstance(values, dict) else {}

    async def subscribe(self, topic: str, kind: str, *, throttle_ms: int) -> None:
        """Ask for the newest message of a topic, one each `throttle_ms` at most."""
        subscription = {
            "op": "subscribe",
            "id": f"robotether_agent:{topic}",
            "topic": topic,
            "type": kind,
        }
        await self._socket.send_json(
            {**subscription, "throttle_rate": throttle_ms, "queue_length": 1}
        )

    async def message(self) -> JsonObject:
        """Return the next message of the topics that were asked for; ConnectionError at the end."""
        while True:
            operation = await self._operation()
            if operation.get("op") == "publish" and isinstance(operation.get("msg"), dict):
                return cast("JsonObject", operation["msg"])

    async def _operation(self) -> JsonObject:
        """Return the next text that is an object; rosbridge also sends its own words of status."""
        while True:
            message = await self._socket.receive()
            if message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY):
                try:
                    return parse_object(message.data, "rosbridge's message")
                except FieldError:
                    continue
            raise ConnectionError(_why_ended(message))


def _why_ended(message: aiohttp.WSMessage) -> str:
    if message.type is aiohttp.WSMsgType.ERROR:
        return f"rosbridge's connection broke: {message.data}"
    return "rosbridge closed the connection"


async def ask_rosapi(url: str, look_up: str, args: Mapping[str, object]) -> JsonObject:
    """Return what one of rosapi's look-ups answers; asyncio.TimeoutError where it does not answer.

    On a connection of its own: rosbridge may handle nothing else on it until the service has answered.
    """
    async with connected(url, max_message_bytes=MAX_ANSWER_BYTES) as rosbridge:
        return await within(ANSWER_WITHIN_S, rosbridge.call(f"/rosapi/{look_up}", args))


async def rosapi_topics(url: str) -> dict[str, str]:
    """Return each topic's type, as rosapi lists them; raises as `ask_rosapi` does."""
    return topics_in({"values": await ask_rosapi(url, "topics", {})})


def is_answer(operation: Mapping[str, object]) -> bool:
    """Whether this is the answer to LOOK_UP."""
    return operation.get("op") == "service_response" and operation.get("id") == LOOK_UP_ID


def topics_in(answer: Mapping[str, object]) -> dict[str, str]:
    """Return the types by topic of an answer of rosapi's; what is not as it should be is left out."""
    values = answer.get("values")
    if not isinstance(values, dict):
        return {}
    names, types = values.get("topics"), values.get("types")
    if not isinstance(names, list) or not isinstance(types, list):
        return {}
    pairs = zip(names, types, strict=False)
    return {n: same_type(t) for n, t in pairs if isinstance(n, str) and isinstance(t, str)}


def own_topic(
    topics: Mapping[str, str], kind: str, usual: Sequence[str], drive_topic: str
) -> str | None:
    """Return this robot's topic of a type, or nothing where it has none or several fit equally well.

    Several robots may share a ROS graph: the drive topic's namespace decides, as on the drive page (ownTopics.js).
    """
    home = _segments(drive_topic)[:-1] if drive_topic else None
    own = [name for name in _without_others(topics, home, drive_topic) if topics[name] == kind]
    ranked = sorted((_rank(name, home or [], usual), name) for name in own)
    is_tie = len(ranked) > 1 and ranked[0][0] == ranked[1][0]
    return ranked[0][1] if ranked and not is_tie else None


def _segments(name: str) -> list[str]:
    return [segment for segment in name.split("/") if segment]


def _shared(path: Sequence[str], home: Sequence[str]) -> int:
    """Return how many leading segments both have."""
    both = zip(path, home, strict=False)
    return next((at for at, (a, b) in enumerate(both) if a != b), min(len(path), len(home)))


def _branch(name: str, home: Sequence[str]) -> tuple[str, ...] | None:
    """Return the namespace in which a topic leaves this robot's; None: it lies in it, or beside the way to it."""
    path = _segments(name)[:-1]
    shared = _shared(path, home)
    leaves = len(path) > shared and (shared < len(home) or not home)
    return tuple(path[: shared + 1]) if leaves else None


def _without_others(
    topics: Mapping[str, str], home: Sequence[str] | None, drive_topic: str
) -> list[str]:
    """Return the topics that lie in no branch with a drive topic of its own: such a branch is another robot."""
    if home is None:
        return list(topics)
    last = _segments(drive_topic)[-1]
    driving = [
        n for n, kind in topics.items() if kind in DRIVE_TYPES or _segments(n)[-1:] == [last]
    ]
    others = {_branch(name, home) for name in driving} - {None}
    return [name for name in topics if _branch(name, home) not in others]


def _rank(name: str, home: Sequence[str], usual: Sequence[str]) -> tuple[int, int, int]:
    """Return what sorts the nearest namespace first, then the usual names, then what lies less deep."""
    path = _segments(name)
    shared = _shared(path[:-1], home)
    within_it = "/".join(path[shared:])
    place = usual.index(within_it) if within_it in usual else len(usual)
    return -shared, place, len(path)


def same_type(kind: str) -> str:
    """Return a type's name as ROS 1 spells it: without the /msg/ of ROS 2."""
    return kind.replace("/msg/", "/")


@asynccontextmanager
async def connected(url: str, *, max_message_bytes: int) -> AsyncIterator[Rosbridge]:
    """Connect, and leave at the end; raises what describe_error knows.

    A cancelled one leaves without a close frame: a rosbridge that hangs must not delay what waits for that, which may
    be the notice to the guard that the session is lost.
    """
    # As in guard/rosbridge.py: aiohttp's own socket cannot be dropped.
    made = cast("type[aiohttp.ClientWebSocketResponse]", _Socket)
    async with aiohttp.ClientSession(ws_response_class=made) as http:
        socket = await within(CONNECT_WITHIN_S, _open(http, url, max_message_bytes))
        try:
            yield Rosbridge(socket)
            await socket.close()
        finally:
            socket.drop()


class _Socket(aiohttp.ClientWebSocketResponse):
    """One that can be dropped; aiohttp makes it as the session's `ws_response_class`."""

    def __init__(
        self, reader: Any, writer: Any, protocol: Any, response: Any, *args: Any, **kwargs: Any
    ) -> None:
        super().__init__(reader, writer, protocol, response, *args, **kwargs)
        self._answer: aiohttp.ClientResponse = response

    def drop(self) -> None:
        """End the connection at once."""
        self._answer.close()


async def _open(http: aiohttp.ClientSession, url: str, max_message_bytes: int) -> _Socket:
    timeouts = aiohttp.ClientWSTimeout(ws_close=CLOSE_WITHIN_S)
    socket = await http.ws_connect(
        url, heartbeat=HEARTBEAT_S, max_msg_size=max_message_bytes, timeout=timeouts
    )
    if not isinstance(socket, _Socket):
        raise TypeError("the session makes sockets of another class")
    return socket
