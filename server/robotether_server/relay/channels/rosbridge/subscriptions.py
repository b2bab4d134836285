"""The topics that one client shares, and what waits for the client.

A `Bridge` has both. Each topic is shared with all who request the same, and a slow client gets the newest.
"""

from __future__ import annotations

import asyncio
import itertools
import math
from collections import deque
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from typing import Any, Protocol

from aiohttp import WSMsgType
from robotether_common.topics import MessageQueue

from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.channels.rosbridge.held_messages import HeldMessages
from robotether_server.relay.channels.rosbridge.message_validator import status_error
from robotether_server.relay.channels.rosbridge.operations import write_json
from robotether_server.relay.channels.rosbridge.shared_topics import (
    MAX_OBSERVED_TOPICS,
    SharedTopic,
    SharedTopics,
    TopicRefusedError,
    TopicRequest,
    combined,
)
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.http.event_loop import next_turn
from robotether_server.relay.robots.uplink import UserIds

# Maximum number of statuses that wait for a client.
MAX_STATUSES = 100
# Length in bytes from which a text of CBOR has its length in a byte of its own.
CBOR_SHORT = 24

Deliver = Callable[[bytes, WSMsgType], Awaitable[None]]
# Sends a message if nothing waits before it, and returns whether it did.
DeliverAtOnce = Callable[[bytes, WSMsgType], bool]

MessageId = str | int | None


def never(_message: bytes, _kind: WSMsgType) -> bool:
    """Send nothing: it has to wait."""
    return False


class TopicSharing(Protocol):
    """How a client comes to the topics that it has subscribed to."""

    @property
    def held(self) -> HeldMessages:
        """What it published that waits for them."""

    def share(
        self,
        topic: str,
        subscription: TopicRequest | None,
        message_id: MessageId = None,
        *,
        is_new: bool = False,
    ) -> None:
        """Share what is requested of a topic now; None: nothing. Statuses of it have this id.

        `is_new`: the client subscribes once more, and gets what a newcomer does.
        """

    async def send(self, deliver: Deliver, at_once: DeliverAtOnce = never) -> CloseReason:
        """Send the client its messages, until this is cancelled."""

    def close(self) -> None:
        """Share nothing any more."""


def change(
    sharing: TopicSharing, message: Mapping[str, Any], requested: Sequence[Mapping[str, Any]]
) -> None:
    """Share what a client requests of a topic after its checked `subscribe` or `unsubscribe`."""
    if not requested:
        sharing.share(message["topic"], None)
        return
    sharing.share(
        message["topic"],
        combined([TopicRequest.of(each) for each in requested]),
        requested[0].get("id"),
        is_new=message["op"] == "subscribe",
    )


class TopicCopies:
    """The topics that one client shares, and what waits for it; implements `shared_topics.TopicClient`."""

    def __init__(
        self,
        robot: RelayRobot,
        user_ids: UserIds,
        shared_topics: SharedTopics,
        limit: int = MAX_OBSERVED_TOPICS,
    ) -> None:
        self.user_ids = user_ids
        self.held = HeldMessages()
        self._robot = robot
        self._limit = limit
        self._shared_topics = shared_topics
        self.joined: dict[str, SharedTopic] = {}
        self._message_ids: dict[str, MessageId] = {}
        # What is requested of each topic that has a queue.
        self._requested: dict[str, TopicRequest] = {}
        self._fragmented = itertools.count(1)
        self._queues: dict[str, MessageQueue[WSMsgType]] = {}
        self._statuses: deque[tuple[bytes, WSMsgType]] = deque(maxlen=MAX_STATUSES)
        self._due = asyncio.Event()
        # While nothing waits: to wake a task for each message takes longer than to send it.
        self._at_once: DeliverAtOnce = never
        self._clock = asyncio.get_running_loop().time

    def on_message(self, topic: str, message: bytes, kind: WSMsgType) -> None:
        """A message of a topic came."""
        requested = self._requested[topic]
        first, *others = requested.names or (topic,)
        has_parts = requested.fragment_size is not None or others
        if has_parts or not self._at_once(renamed(message, topic, first), kind):
            self._queues[topic].push(message, kind, self._clock())
            self._wake()

    def on_topic_ready(self, topic: str) -> None:
        """The robot's rosbridge has the subscription."""
        self.held.release(topic)

    def on_topic_failed(self, topic: str, why: str) -> None:
        """The topic brings nothing for now."""
        self.held.release(topic)
        message_id = self._message_ids.get(topic)
        text = status_error(f"cannot subscribe to {topic}: {why}", message_id)
        self._add_status(text, WSMsgType.TEXT)

    async def send(self, deliver: Deliver, at_once: DeliverAtOnce = never) -> CloseReason:
        """Send what waits, a message of each topic in turn, until this is cancelled."""
        while True:
            if not self._due.is_set():
                self._at_once = at_once
                await self._due.wait()
            self._due.clear()
            while self._statuses:
                await deliver(*self._statuses.popleft())
            while waiting := [topic for topic, queue in self._queues.items() if queue]:
                for topic in waiting:
                    if queue := self._queues.get(topic):
                        await self._deliver(deliver, self._requested[topic], *queue.pop())

    async def _deliver(
        self, deliver: Deliver, requested: TopicRequest, message: bytes, kind: WSMsgType
    ) -> None:
        topic = requested.topic
        for name in requested.names or (topic,):
            await self._deliver_one(
                deliver, requested.fragment_size, renamed(message, topic, name), kind
            )

    async def _deliver_one(
        self, deliver: Deliver, size: int | None, message: bytes, kind: WSMsgType
    ) -> None:
        count = 0
        if size is None or kind is not WSMsgType.TEXT or len(message) <= size:
            await deliver(message, kind)
            return
        for fragment in fragments(message, size, next(self._fragmented)):
            count = await next_turn(count)
            await deliver(fragment, kind)

    def close(self) -> None:
        """End all subscriptions."""
        for topic in list(self.joined):
            self.share(topic, None)

    def share(
        self,
        topic: str,
        subscription: TopicRequest | None,
        message_id: MessageId = None,
        *,
        is_new: bool = False,
    ) -> None:
        """Share what is requested of a topic now; None: nothing."""
        self._message_ids[topic] = message_id
        if subscription is not None:
            self._requested[topic] = subscription
        joined = self.joined.get(topic)
        if joined is not None:
            if joined.key == subscription:
                if is_new:
                    self._shared_topics.give_missed(joined, self)
                return
            del self.joined[topic]
            self._shared_topics.leave(joined, self)
            self.held.release(topic)
        if subscription is None:
            del self._message_ids[topic]
            self._requested.pop(topic, None)
            self._queues.pop(topic, None)
            return
        self._queues[topic] = MessageQueue(subscription.queue_length)
        try:
            shared = self._shared_topics.join(self._robot, subscription, self, self._limit)
        except TopicRefusedError as refused:
            self.on_topic_failed(topic, refused.detail)
            return
        self.joined[topic] = shared
        if not shared.is_ready and shared.failure is None:
            self.held.begin(topic)

    def _add_status(self, status: bytes, kind: WSMsgType) -> None:
        self._statuses.append((status, kind))
        self._wake()

    def _wake(self) -> None:
        self._at_once = never
        self._due.set()


def renamed(message: bytes, topic: str, name: str) -> bytes:
    """Return what rosbridge published on a topic, in JSON or CBOR, under another name of at most 255 bytes."""
    if name == topic:
        return message
    # Before the name are the operation and the member's own name.
    head = message[: 40 + 2 * len(topic)]
    for write in (write_json, _ujson_text, _cbor_text):
        if write(topic) in head:
            return message.replace(write(topic), write(name), 1)
    return message


def fragments(message: bytes, size: int, number: int) -> Iterator[bytes]:
    """Yield a text as rosbridge's fragments of up to `size` characters each; the number tells it from other texts."""
    text = message.decode(errors="replace")
    total = math.ceil(len(text) / size)
    for num in range(total):
        part = text[num * size : (num + 1) * size]
        members = {"op": "fragment", "id": str(number), "data": part, "num": num, "total": total}
        yield write_json(members)


def _ujson_text(text: str) -> bytes:
    """Write a text as rosbridge does on robots that have ujson."""
    return write_json(text).replace(b"/", rb"\/")


def _cbor_text(text: str) -> bytes:
    data = text.encode()
    length = bytes([0x60 + len(data)]) if len(data) < CBOR_SHORT else bytes([0x78, len(data)])
    return length + data
