"""One subscription on the robot for all who request the same of a topic, and one copy of each message up to here.

`subscriptions` joins one for each topic of a connection; a `TopicLink` brings each its messages. Nothing of a message
is parsed: each link carries one subscription. Nothing queues here but what newcomers get: rosbridge repeats a latched
message to a new subscription, and this one is an old one to it.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Collection, Coroutine, Mapping
from dataclasses import dataclass, fields
from typing import Any, Protocol, cast

from aiohttp import WSMsgType
from robotether_common.topics import MAX_KNOWN, digest

from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.channels.rosbridge.operations import write_json
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import Change

log = logging.getLogger(__name__)

# Time for which a subscription stays without subscribers, for a page that reloads.
LINGER_S = 0.5
# Maximum size of the messages that newcomers may get, besides the newest.
MAX_REMEMBERED_BYTES = 1024 * 1024


@dataclass(frozen=True)
class TopicRequest:
    """What is requested of a topic, as rosbridge's fields of the same names; None and 0 are its defaults.

    `qos` is JSON.
    """

    topic: str
    type: str | None = None
    throttle_rate: int = 0
    queue_length: int = 0
    fragment_size: int | None = None
    compression: str = "none"
    qos: bytes | None = None

    @classmethod
    def of(cls, message: Mapping[str, Any]) -> TopicRequest:
        """Return what a checked message requests."""
        qos = message.get("qos")
        return cls(
            message["topic"],
            message.get("type"),
            message.get("throttle_rate", 0),
            message.get("queue_length", 0),
            message.get("fragment_size"),
            message.get("compression", "none"),
            None if qos is None else write_json(qos),
        )

    def message(self) -> bytes:
        """Return it as a message to rosbridge."""
        members = {
            field.name: getattr(self, field.name)
            for field in fields(self)
            if field.name != "qos" and getattr(self, field.name) != field.default
        }
        text = write_json({"op": "subscribe", **members})
        return text if self.qos is None else text[:-1] + b',"qos":' + self.qos + b"}"


# Of several compressions of one client rosbridge takes the last of these.
COMPRESSIONS = ("none", "png", "cbor", "cbor-raw")


def combined(subscriptions: Collection[TopicRequest]) -> TopicRequest:
    """Return what rosbridge makes of several subscriptions of one client to a topic; there is at least one."""
    sizes = [each.fragment_size for each in subscriptions if each.fragment_size is not None]
    return TopicRequest(
        next(iter(subscriptions)).topic,
        next((each.type for each in subscriptions if each.type is not None), None),
        min(each.throttle_rate for each in subscriptions),
        min(each.queue_length for each in subscriptions),
        min(sizes, default=None),
        max((each.compression for each in subscriptions), key=COMPRESSIONS.index),
        next((each.qos for each in subscriptions if each.qos is not None), None),
    )


class TopicClient(Protocol):
    """A client's connection; what it is told must not wait."""

    def on_message(self, topic: str, message: bytes, kind: WSMsgType) -> None:
        """A message of a topic came."""

    def on_topic_failed(self, topic: str, why: str) -> None:
        """The topic brings nothing for now."""


class SharedTopic:
    """One subscription on a robot, and who shares it."""

    def __init__(self, robot: RelayRobot, subscription: TopicRequest) -> None:
        self.robot = robot
        self.subscription = subscription
        self.subscribers: set[TopicClient] = set()
        # Why it brings nothing now; None: it does, or that is not known yet.
        self.failure: str | None = None
        # What newcomers may get, the newest last.
        self._remembered: deque[tuple[bytes, WSMsgType]] = deque()
        self._remembered_bytes = 0

    def on_message(self, message: bytes, kind: WSMsgType) -> None:
        """Give a message to all who share the topic."""
        self.failure = None
        self._remember(message, kind)
        for subscriber in list(self.subscribers):
            subscriber.on_message(self.subscription.topic, message, kind)

    def on_failed(self, why: str) -> None:
        """Tell all, once, that it brings nothing for now."""
        if self.failure is None:
            for subscriber in list(self.subscribers):
                subscriber.on_topic_failed(self.subscription.topic, why)
        self.failure = why

    def known(self) -> dict[str, tuple[bytes, WSMsgType]]:
        """Return the messages that newcomers may get, by digest."""
        return {digest(message): (message, kind) for message, kind in self._remembered}

    def _remember(self, message: bytes, kind: WSMsgType) -> None:
        remembered = self._remembered
        remembered.append((message, kind))
        self._remembered_bytes += len(message)
        while len(remembered) > MAX_KNOWN or (
            self._remembered_bytes > MAX_REMEMBERED_BYTES and len(remembered) > 1
        ):
            self._remembered_bytes -= len(remembered.popleft()[0])


class TopicConnector(Protocol):
    """Who brings topics their messages."""

    async def run(self, topic: SharedTopic) -> None:
        """Bring its messages until this is cancelled."""

    async def repeat(self, topic: SharedTopic, known: Collection[str]) -> list[str]:
        """Return the digests of those known messages that rosbridge repeats to a newcomer."""


class SharedTopics:
    """All shared topics, by robot and subscription."""

    def __init__(self, registry: SessionRegistry, connector: TopicConnector) -> None:
        self._registry = registry
        self._connector = connector
        self._tasks: dict[SharedTopic, asyncio.Task[None]] = {}
        # Those that end, and those that ask what a newcomer missed.
        self._all: set[asyncio.Task[None]] = set()

    def join(
        self, robot: RelayRobot, subscription: TopicRequest, subscriber: TopicClient, limit: int
    ) -> SharedTopic | None:
        """Share a topic; None: it is a new one, and the robot sends `limit` already."""
        topics = self._of(robot.id)
        topic = topics.get(subscription)
        if topic is None:
            if len(topics) >= limit:
                return None
            topic = SharedTopic(robot, subscription)
            self._registry.ensure_robot(robot.id).topics[subscription] = topic
            self._tasks[topic] = self._start(self._run(topic), topic)
        elif topic.failure is not None:
            subscriber.on_topic_failed(subscription.topic, topic.failure)
        elif known := topic.known():
            self._start(self._repeat(topic, known, subscriber), topic)
        topic.subscribers.add(subscriber)
        return topic

    def leave(self, topic: SharedTopic, subscriber: TopicClient) -> None:
        """Share it no more; the last one's leaving ends it after a while."""
        topic.subscribers.discard(subscriber)
        if not topic.subscribers:
            asyncio.get_running_loop().call_later(LINGER_S, self._end_unless_shared, topic)

    def on_robot_change(self, change: Change) -> None:
        """Something happened to a robot; with its session end its topics."""
        if change.what == "disconnected":
            for topic in list(self._of(change.robot_id).values()):
                self._end(topic)

    async def close(self) -> None:
        """End all topics; the relay stops."""
        for task in self._all:
            task.cancel()
        await asyncio.gather(*self._all, return_exceptions=True)

    def count(self) -> int:
        """How many topics are shared."""
        return len(self._tasks)

    def _of(self, robot_id: int) -> dict[TopicRequest, SharedTopic]:
        # Nobody else makes one.
        return cast(dict[TopicRequest, SharedTopic], self._registry.robot(robot_id).topics)

    def _start(self, work: Coroutine[Any, Any, None], topic: SharedTopic) -> asyncio.Task[None]:
        name = f"topic {topic.subscription.topic} of {topic.robot.name}"
        task: asyncio.Task[None] = asyncio.create_task(work, name=name)
        self._all.add(task)
        task.add_done_callback(self._all.discard)
        return task

    async def _run(self, topic: SharedTopic) -> None:
        try:
            with self._registry.ensure_robot(topic.robot.id).media_demand.counted():
                await self._connector.run(topic)
        except Exception:
            log.exception("robot %s: a topic failed", topic.robot.name)
            topic.on_failed("the relay failed")
        finally:
            self._forget(topic)

    async def _repeat(
        self,
        topic: SharedTopic,
        known: Mapping[str, tuple[bytes, WSMsgType]],
        subscriber: TopicClient,
    ) -> None:
        name = topic.subscription.topic
        repeated = await self._connector.repeat(topic, known.keys())
        # Each publisher of static transforms has latched one, of which rosbridge for ROS 2 repeats the last alone.
        digests = known.keys() if repeated and name.endswith("/tf_static") else repeated
        for each in digests:
            if subscriber in topic.subscribers:
                subscriber.on_message(name, *known[each])

    def _end_unless_shared(self, topic: SharedTopic) -> None:
        if not topic.subscribers:
            self._end(topic)

    def _end(self, topic: SharedTopic) -> None:
        task = self._tasks.get(topic)
        self._forget(topic)
        if task is not None:
            task.cancel()

    def _forget(self, topic: SharedTopic) -> None:
        """Let the next subscriber open a new one."""
        self._tasks.pop(topic, None)
        topics = self._of(topic.robot.id)
        if topics.get(topic.subscription) is topic:
            del topics[topic.subscription]
