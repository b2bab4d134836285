"""The agent's own use of rosbridge: asks rosapi what the robot has, and subscribes to a topic.

`RosGraph` answers for health, battery and video, over one connection. Each subscription has its own, only
while somebody needs it. Never publishes, and calls only rosapi's look-ups. A single task reads the messages of a
connection.
"""

from __future__ import annotations

import asyncio
import itertools
import logging
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from typing import Any, TypeVar, cast

import aiohttp
from aiohttp.http_websocket import WSMessageNoDecodeText
from robotether_common.frames import MAX_FRAME_BYTES
from robotether_common.own_topics import own_topics, same_type

from robotether_agent.fields import FieldError, JsonObject, parse_object
from robotether_agent.rosbridge_socket import RosbridgeSocket, new_http, open_rosbridge
from robotether_agent.tasks import within

ANSWER_WITHIN_S = 3.0
HEARTBEAT_S = 10.0
CALL_ID = "robotether_agent:call"
# Interval before a rosapi that did not answer is asked again, on a new connection.
SILENT_S = 120.0
# Interval between checks that a topic is the robot's still.
CHOSEN_AGAIN_EVERY_S = 30.0
# Maximum size of an answer: the list of all topics of a large robot.
MAX_ANSWER_BYTES = 1024 * 1024
# Maximum size of a message of a camera: a frame in base64, and its envelope.
MAX_IMAGE_MESSAGE_BYTES = MAX_FRAME_BYTES // 3 * 4 + 64 * 1024

T = TypeVar("T")

log = logging.getLogger(__name__)


class Rosbridge:
    """One connection."""

    def __init__(self, socket: RosbridgeSocket) -> None:
        self._socket = socket
        # What a message is of that cannot be read; None: that was logged.
        self._what: str | None = "rosapi"
        self._ids = itertools.count()

    async def call(self, service: str, args: Mapping[str, object]) -> JsonObject:
        """Return what a service answers, nothing if it refuses. On a connection without subscriptions only."""
        # One that is answered twice must not answer the next call, too.
        sent_id = f"{CALL_ID}:{next(self._ids)}"
        await self.send_call(sent_id, service, args)
        while True:
            call_id, values = await self.answer()
            if call_id == sent_id:
                return values

    async def send_call(self, call_id: str, service: str, args: Mapping[str, object]) -> None:
        """Call a service; `answer` gives what it says."""
        call = {"op": "call_service", "id": call_id, "service": service, "args": args}
        await self._socket.send_json(call)

    async def answer(self) -> tuple[str, JsonObject]:
        """Return the id of the next call that is answered, and the answer, which is empty if the service refused."""
        while True:
            operation = await self._operation()
            call_id, values = operation.get("id"), operation.get("values")
            if operation.get("op") == "service_response" and isinstance(call_id, str):
                return call_id, cast("JsonObject", values if isinstance(values, dict) else {})

    async def subscribe(
        self, topic: str, kind: str, *, throttle_ms: int, queue_length: int = 1
    ) -> None:
        """Ask for the newest message of a topic, one each `throttle_ms` at most; with both 0 for all."""
        self._what = topic
        subscription = {
            "op": "subscribe",
            "id": f"robotether_agent:{topic}",
            "topic": topic,
            "type": kind,
        }
        await self._socket.send_json(
            {**subscription, "throttle_rate": throttle_ms, "queue_length": queue_length}
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
                except FieldError as error:
                    self._log_unread(error)
                    continue
            raise ConnectionError(_why_ended(message))

    def _log_unread(self, error: FieldError) -> None:
        if self._what is not None:
            log.warning("cannot read a message of %s: %s", self._what, error)
            self._what = None


def _why_ended(message: WSMessageNoDecodeText) -> str:
    if message.type is aiohttp.WSMsgType.ERROR:
        return f"rosbridge's connection broke: {message.data}"
    return "rosbridge closed the connection"


class RosGraph:
    """Asks rosapi what there is on the robot's ROS graph, over one connection that stays open and carries nothing else.

    So a rosapi that is silent costs this connection alone, and rosbridge's log has no line for each question.
    """

    def __init__(self, url: str) -> None:
        # Tells this robot's topics from another's on the same graph; empty while no server has named it.
        self.drive_topic = ""
        self.url = url
        self._opened: asyncio.Future[Rosbridge]
        self._reader: asyncio.Future[None] | None = None
        self._ids = itertools.count()
        self._answers: dict[str, asyncio.Future[JsonObject]] = {}
        # When an answer was late first, of those that have not come yet.
        self._silent_since_s: float | None = None

    async def topics(self) -> dict[str, str]:
        """Return each topic's type; raises as `ask` does, and ConnectionError where rosapi does not say."""
        return topics_in(await self.ask("topics", {}))

    async def own_topics(self) -> dict[str, str]:
        """Return the types of this robot's topics; raises as `topics` does."""
        return own_topics(await self.topics(), self.drive_topic)

    async def until_another(
        self, topic: str, choose: Callable[[Mapping[str, str]], str | None]
    ) -> None:
        """Wait until another topic than this is chosen of the graph, or none though this one is there.

        A robot on the same graph may start later, and the server may change the drive topic.
        """
        while True:
            await asyncio.sleep(CHOSEN_AGAIN_EVERY_S)
            with suppress(aiohttp.ClientError, OSError, asyncio.TimeoutError):
                topics = await self.topics()
                chosen = choose(topics)
                if chosen != topic and (chosen or topic in topics):
                    return

    async def is_published(self, topic: str) -> bool:
        """Whether somebody publishes a topic, as far as rosapi says; raises as `ask` does."""
        return (await self.ask("publishers", {"topic": topic})).get("publishers") != []

    async def ask(self, look_up: str, args: Mapping[str, object]) -> JsonObject:
        """Return what one of rosapi's look-ups answers.

        asyncio.TimeoutError where it does not answer, at once if it is known to be silent; else as `connected`.
        """
        now_s = asyncio.get_running_loop().time()
        if self._silent_since_s is not None and self._reader is not None:
            if now_s - self._silent_since_s < SILENT_S:
                raise asyncio.TimeoutError
            await self.close()
        try:
            return await within(ANSWER_WITHIN_S, self._answer(look_up, args))
        except asyncio.TimeoutError:
            self._silent_since_s = now_s
            raise

    async def close(self) -> None:
        """End the connection; the next question opens another one."""
        if self._reader is not None:
            self._reader.cancel()
            await asyncio.wait({self._reader})

    async def _answer(self, look_up: str, args: Mapping[str, object]) -> JsonObject:
        loop = asyncio.get_running_loop()
        if self._reader is None:
            self._silent_since_s = None
            self._opened = loop.create_future()
            self._reader = asyncio.ensure_future(self._read(self._opened))
            self._reader.add_done_callback(self._on_end)
        reader = self._reader
        rosbridge = await _unless_ended(self._opened, reader)
        call_id = f"{CALL_ID}:{next(self._ids)}"
        self._answers[call_id] = answer = loop.create_future()
        try:
            await rosbridge.send_call(call_id, f"/rosapi/{look_up}", args)
            return await _unless_ended(answer, reader)
        finally:
            del self._answers[call_id]

    async def _read(self, opened: asyncio.Future[Rosbridge]) -> None:
        async with connected(self.url, max_message_bytes=MAX_ANSWER_BYTES) as rosbridge:
            opened.set_result(rosbridge)
            while True:
                call_id, values = await rosbridge.answer()
                self._silent_since_s = None
                answer = self._answers.get(call_id)
                if answer is not None and not answer.done():
                    answer.set_result(values)

    def _on_end(self, reader: asyncio.Future[None]) -> None:
        self._reader = self._silent_since_s = None
        if not reader.cancelled():
            # Whoever asks now is told; if nobody does, asyncio must not complain.
            reader.exception()


async def _unless_ended(awaited: asyncio.Future[T], reader: asyncio.Future[None]) -> T:
    """Return what is awaited, or raise what ended the reader."""
    futures: set[asyncio.Future[Any]] = {awaited, reader}
    await asyncio.wait(futures, return_when=asyncio.FIRST_COMPLETED)
    if not awaited.done():
        if reader.cancelled():
            raise ConnectionError("the connection to rosapi was closed")
        reader.result()
    return awaited.result()


def topics_in(answer: JsonObject) -> dict[str, str]:
    """Return the types by topic of an answer of rosapi's, without names and types that are none.

    ConnectionError for an answer without both lists, as where rosbridge does not find rosapi: nobody knows then.
    """
    names, types = answer.get("topics"), answer.get("types")
    if not isinstance(names, list) or not isinstance(types, list) or len(names) != len(types):
        raise ConnectionError("rosapi does not say which topics there are")
    pairs = zip(names, types, strict=True)
    return {n: same_type(t) for n, t in pairs if isinstance(n, str) and isinstance(t, str)}


@asynccontextmanager
async def connected(url: str, *, max_message_bytes: int) -> AsyncIterator[Rosbridge]:
    """Connect, and leave at the end; raises what describe_error knows.

    A cancelled one leaves without a close frame: a rosbridge that hangs must not delay what waits for that, which may
    be the notice to the guard that the session is lost.
    """
    async with new_http() as http:
        socket = await open_rosbridge(
            http, url, max_message_bytes=max_message_bytes, heartbeat_s=HEARTBEAT_S
        )
        try:
            yield Rosbridge(socket)
            await socket.close()
        finally:
            socket.drop()
