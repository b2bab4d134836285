"""The topics service: one subscription a connection, for the relay, which shares each among all who subscribe.

The media service answers /robotether/topics with it (docs/reference/media.md, "Topics"). So subscribed topics travel
beside the video, in the pacer's turns, and never before a command. Messages pass unchanged. If the connection is slower
than the topic, the newest message waits and older ones are dropped. The relay's ping goes to rosbridge, and its pong
follows all earlier messages, which bounds their age.

rosbridge gets only a subscription from here, as this way leads past the guard.
"""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Mapping
from contextlib import suppress

import aiohttp
from aiohttp import WSCloseCode, WSMsgType, web
from robotether_common.guard import REASON_HEADER
from robotether_common.topics import (
    KNOWN,
    KNOWN_OP,
    MAX_SUBSCRIPTION_BYTES,
    MAX_TOPICS,
    MessageQueue,
    digest,
)

from robotether_agent.describe_error import describe_error
from robotether_agent.fields import (
    TOPIC,
    FieldError,
    JsonObject,
    get_match,
    parse_object,
    printable,
)
from robotether_agent.rosbridge_socket import (
    CONNECT_WITHIN_S,
    FAREWELL_S,
    RosbridgeSocket,
    close_reason,
    is_too_large,
    new_http,
    open_rosbridge,
    why_ended,
)
from robotether_agent.tasks import first_of, within
from robotether_agent.unsent import SEND_BYTES, keep_little_unsent

# Maximum number of connections: for each topic one, and briefly one that asks what a newcomer missed.
MAX_CONNECTIONS = 2 * MAX_TOPICS
SUBSCRIPTION_WITHIN_S = 5.0
# Time for which a new subscription is watched for what rosbridge repeats to newcomers; ROS 2 has to find it first.
REPEATED_WITHIN_S = 2.0
# Maximum number of pongs that wait behind messages; beyond it the oldest are dropped, which only makes ages greater.
MAX_PONGS = 64
# What a subscription may hold.
MEMBERS = frozenset(("op", "topic", "type", "throttle_rate", "queue_length", "compression", "qos"))


class TopicsService:
    """All subscriptions of the relay; `close` ends the way to rosbridge."""

    def __init__(self, rosbridge_url: str) -> None:
        self._url = rosbridge_url
        self._http = new_http()
        self._count = 0

    async def answer(self, request: web.Request) -> web.StreamResponse:
        """Serve one connection until either side ends it."""
        relay = web.WebSocketResponse(
            timeout=FAREWELL_S,
            autoping=False,
            compress=False,
            max_msg_size=MAX_SUBSCRIPTION_BYTES,
            writer_limit=SEND_BYTES,
        )
        if not relay.can_prepare(request):
            raise web.HTTPNotFound(text="connect with a WebSocket\n")
        if self._count >= MAX_CONNECTIONS:
            why = f"{self._count} topics are open"
            raise web.HTTPServiceUnavailable(headers={REASON_HEADER: why})
        self._count += 1
        try:
            return await self._join(request, relay)
        finally:
            self._count -= 1

    async def close(self) -> None:
        """Connect to rosbridge no more."""
        await self._http.close()

    async def _join(self, request: web.Request, relay: web.WebSocketResponse) -> web.StreamResponse:
        try:
            rosbridge = await open_rosbridge(self._http, self._url)
        except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
            why = describe_error(error, CONNECT_WITHIN_S)
            reason = printable(f"rosbridge does not answer: {why}")
            raise web.HTTPBadGateway(headers={REASON_HEADER: reason}) from error
        try:
            keep_little_unsent(request)
            await relay.prepare(request)
            digests = request.query.get(KNOWN)
            await self._serve(relay, rosbridge, None if digests is None else digests.split(","))
        finally:
            rosbridge.drop()
        return relay

    async def _serve(
        self,
        relay: web.WebSocketResponse,
        rosbridge: RosbridgeSocket,
        digests: list[str] | None,
    ) -> None:
        # Either side may be gone at any time.
        with suppress(ConnectionError, asyncio.TimeoutError):
            first = await within(SUBSCRIPTION_WITHIN_S, relay.receive())
            if first.type is not WSMsgType.TEXT:
                return
            try:
                subscription = parse_subscription(first.data)
            except FieldError as error:
                await relay.close(code=WSCloseCode.PROTOCOL_ERROR, message=close_reason(str(error)))
                return
            await rosbridge.send_frame(json.dumps(subscription).encode(), WSMsgType.TEXT)
            stream = TopicStream(relay, rosbridge, subscription)
            if digests is None:
                await first_of(stream.read(), stream.send(), stream.until_left())
            else:
                await first_of(stream.name_repeated(frozenset(digests)), stream.until_left())
            await relay.close(code=stream.code, message=close_reason(stream.why))


class TopicStream:
    """The messages of one subscription."""

    def __init__(
        self,
        relay: web.WebSocketResponse,
        rosbridge: RosbridgeSocket,
        subscription: Mapping[str, object],
    ) -> None:
        self._relay = relay
        self._rosbridge = rosbridge
        queue_length = subscription.get("queue_length", 0)
        self._queue: MessageQueue[WSMsgType] = MessageQueue(
            queue_length if isinstance(queue_length, int) else 0
        )
        # Of rosbridge, to the relay's pings.
        self._pongs: deque[bytes] = deque(maxlen=MAX_PONGS)
        self._clock = asyncio.get_running_loop().time
        self._has_message = asyncio.Event()
        # Why rosbridge ended it, for people; empty: it did not say.
        self.why = ""
        self.code = WSCloseCode.OK

    async def read(self) -> None:
        """Take what rosbridge sends until it ends."""
        while (message := await self._next()) is not None:
            self._queue.push(*message, self._clock())
            self._has_message.set()

    async def send(self) -> None:
        """Pass on what is there, as the connection takes it."""
        while True:
            await self._has_message.wait()
            self._has_message.clear()
            while self._queue:
                message, kind = self._queue.pop()
                await self._relay.send_frame(message, kind)
            while self._pongs and not self._queue:
                await self._relay.pong(self._pongs.popleft())

    async def until_left(self) -> None:
        """Pass pings on until the relay goes; it has no more to say."""
        while (message := await self._relay.receive()).type is WSMsgType.PING:
            await self._rosbridge.ping(message.data)
        if message.type in (WSMsgType.TEXT, WSMsgType.BINARY):
            await self._relay.close(code=WSCloseCode.PROTOCOL_ERROR)

    async def name_repeated(self, digests: frozenset[str]) -> None:
        """Name what rosbridge repeats to a newcomer and the relay still has, up to the first other message."""
        with suppress(asyncio.TimeoutError):
            while (message := await within(REPEATED_WITHIN_S, self._next())) is not None:
                name = digest(message[0])
                if name not in digests:
                    return
                await self._relay.send_json({"op": KNOWN_OP, "digest": name})

    async def _next(self) -> tuple[bytes, WSMsgType] | None:
        while True:
            message = await self._rosbridge.receive()
            if message.type in (WSMsgType.TEXT, WSMsgType.BINARY):
                return message.data, message.type
            if message.type is WSMsgType.PING:
                await self._rosbridge.pong(message.data)
            elif message.type is WSMsgType.PONG:
                self._pongs.append(message.data)
                self._has_message.set()
            else:
                self.why = why_ended(message)
                if is_too_large(message):
                    self.code = WSCloseCode.MESSAGE_TOO_BIG
                return None


def parse_subscription(text: str) -> JsonObject:
    """Return a subscription that rosbridge may get; FieldError for anything else.

    What goes on is written anew, so no parser can find another operation in it.
    """
    subscription = parse_object(text, "the subscription")
    if subscription.get("op") != "subscribe":
        raise FieldError("field op must be subscribe")
    if not subscription.keys() <= MEMBERS:
        raise FieldError("a subscription has no other fields than rosbridge's")
    get_match(subscription, "topic", TOPIC, "a topic's full name")
    for name, value in subscription.items():
        # A profile holds durations, which may be objects.
        if not _is_plain(value, 2 if name == "qos" else 0):
            raise FieldError(f"field {name} must be plain")
    return subscription


def _is_plain(value: object, levels: int) -> bool:
    """Return whether it is no array, has objects in this many levels at most, and none could be an operation."""
    if isinstance(value, dict):
        inner = all(_is_plain(each, levels - 1) for each in value.values())
        return levels > 0 and "op" not in value and inner
    return value is None or isinstance(value, (str, int, float))
