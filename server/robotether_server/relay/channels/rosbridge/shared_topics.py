"""One subscription on the robot for all who request the same of a topic, and one copy of each message up to here.

`subscriptions` joins one for each topic of a connection; `topic_link` brings each its messages. Nothing of a message is
parsed: each link carries one subscription. Only messages for newcomers queue here: rosbridge repeats a latched message
to a new subscription, but a shared one is not new to it.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from operator import attrgetter
from typing import Any, Protocol

from aiohttp import WSMsgType
from robotether_common.topics import MAX_KNOWN, MAX_TOPICS, digest

from robotether_server.db.fleet import RelayRobot
from robotether_server.problems import RobotetherError
from robotether_server.relay.channels.rosbridge.drive_path import CommandTimestamps
from robotether_server.relay.channels.rosbridge.operations import COMPRESSIONS, write_json
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.shared_copies import (
    LINGER_S,
    CopyUser,
    SharedCopies,
    SharedCopy,
)

log = logging.getLogger(__name__)

# Maximum number of topics at which an observer may add one, and recorder and routes: observers who ask for everything
# leave these their share, and all leave the driver's.
MAX_OBSERVED_TOPICS, MAX_STANDING_TOPICS = MAX_TOPICS // 2, MAX_TOPICS * 3 // 4
# Number of topics that an observer alone has, for each one that is left, from which on it adds none: at 22 of 32 the
# first, at 7 the next, at 2 the third.
OWN_FOR_EACH_LEFT = 2
# Maximum size of the messages that newcomers may get, besides the newest.
MAX_REMEMBERED_BYTES = 1024 * 1024
# Maximum size of all messages of one robot that are larger than that, unless it is one.
MAX_LARGE_BYTES = 32 * 1024 * 1024
# Time for which what the robot names as repeated may still come by the topic's own connection, as a new message.
REPEAT_AFTER_S = 0.3
# Members of a request that rosbridge does not get, or not as text.
NOT_SENT = ("qos", "fragment_size", "names")
UNKEPT = f"its last message is not kept: the large ones of this robot take over {MAX_LARGE_BYTES >> 20} MB"


@dataclass(frozen=True)
class TopicRequest:
    """What is requested of a topic, as rosbridge's fields of the same names; None and 0 are its defaults.

    `qos` is JSON. Two that differ in what each client's relay does share a topic: `fragment_size` is the length of the
    texts of which the client gets a longer message. `names` are the topic's as the client gave them, with the
    first slash or without: it gets each message under each, as from rosbridge. Empty: under the whole name.
    """

    topic: str
    type: str | None = None
    throttle_rate: int = 0
    queue_length: int = 0
    fragment_size: int | None = field(default=None, compare=False)
    compression: str = "none"
    qos: bytes | None = None
    names: tuple[str, ...] = field(default=(), compare=False)

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
            message.get("names", ()),
        )

    def message(self) -> bytes:
        """Return it as a message to rosbridge."""
        members = {
            member.name: getattr(self, member.name)
            for member in fields(self)
            if member.name not in NOT_SENT and getattr(self, member.name) != member.default
        }
        text = write_json({"op": "subscribe", **members})
        return text if self.qos is None else text[:-1] + b',"qos":' + self.qos + b"}"


def combined(subscriptions: Collection[TopicRequest]) -> TopicRequest:
    """Return what rosbridge makes of several subscriptions of one client to a topic; there is at least one.

    Another name than the whole stands in no PNG: what comes under one comes uncompressed.
    """
    topic = next(iter(subscriptions)).topic
    names = tuple(dict.fromkeys(name for each in subscriptions for name in each.names))
    compression = max((each.compression for each in subscriptions), key=COMPRESSIONS.index)
    sizes = [each.fragment_size for each in subscriptions if each.fragment_size is not None]
    return TopicRequest(
        topic,
        next((each.type for each in subscriptions if each.type is not None), None),
        min(each.throttle_rate for each in subscriptions),
        min(each.queue_length for each in subscriptions),
        min(sizes, default=None),
        "none" if compression == "png" and {*names} - {topic} else compression,
        next((each.qos for each in subscriptions if each.qos is not None), None),
        names,
    )


class TopicClient(CopyUser, Protocol):
    """A client's connection; what it is told must not wait."""

    def on_message(self, topic: str, message: bytes, kind: WSMsgType) -> None:
        """A message of a topic came."""

    def on_topic_ready(self, topic: str) -> None:
        """The robot's rosbridge has the subscription."""

    def on_topic_failed(self, topic: str, why: str) -> None:
        """The topic brings nothing for now."""


@dataclass(frozen=True, eq=False)
class ReceivedMessage:
    """The message `number` of a copy, as it came at `received_s` of the loop's clock."""

    data: bytes
    kind: WSMsgType
    received_s: float
    copy: str
    number: int

    @property
    def sequence(self) -> str:
        """What tells it from all others of any topic."""
        return f"{self.copy}-{self.number}"


class SharedTopic(SharedCopy[TopicRequest, TopicClient]):
    """One subscription on a robot, and the clients that share it."""

    def __init__(
        self,
        robot: RelayRobot,
        subscription: TopicRequest,
        all_of_robot: Callable[[], Iterable[SharedTopic]] = tuple,
    ) -> None:
        super().__init__(robot, subscription)
        self._all_of_robot = all_of_robot
        # Whether rosbridge has the subscription.
        self.is_ready = False
        # Why it brings nothing now; None: it does, or that is not known yet.
        self.failure: str | None = None
        # The last failure of which each client was notified since the last message: one may come again and again.
        self._notified: dict[TopicClient, str] = {}
        # What newcomers may get, the newest last.
        self._remembered: deque[ReceivedMessage] = deque()
        self._remembered_bytes = 0
        # Whether the newest message was too large to be kept beside the robot's others.
        self.is_unkept = False
        # The clients since the robot was asked what it repeats, and those for whom it is asked, with the digests of the
        # messages that they missed.
        self.newcomers: dict[TopicClient, set[str]] = {}
        self.asking: dict[TopicClient, set[str]] = {}
        self.is_asked_for = False
        # What the robot repeated when it was asked last. Another takes its place when a message comes or the connection
        # ends: from then on the robot may repeat something else.
        self.repeated: list[tuple[bytes, WSMsgType]] = []
        # Set by each new subscription.
        self.has_newcomer = asyncio.Event()
        # Since when its messages may have been on the way, of the robot's own connection; set for those who need ages.
        self.timestamps: CommandTimestamps | None = None
        self.is_dated = asyncio.Event()
        self._dated_for: set[TopicClient] = set()
        # Of another copy, at another time or another cell, no message has the same.
        self._name = secrets.token_hex(8)
        self.message_count = 0
        self._clock = asyncio.get_running_loop().time

    def on_ready(self) -> None:
        """Tell all that rosbridge has the subscription."""
        self.failure, self.is_ready = None, True
        for subscriber in list(self.users):
            subscriber.on_topic_ready(self.key.topic)

    def on_message(self, message: bytes, kind: WSMsgType) -> None:
        """Give a message to all who share the topic."""
        if not self.is_ready:
            self.on_ready()
        self._notified.clear()
        self.repeated = []
        self._remember(message, kind)
        if self.is_asked_for:
            self._note_received(digest(message))
        for subscriber in list(self.users):
            subscriber.on_message(self.key.topic, message, kind)

    def on_failed(self, why: str) -> None:
        """Tell all, once, that it brings nothing for now."""
        has_recovered, self.failure, self.is_ready = self.failure is None, why, False
        self.repeated = []
        for subscriber in list(self.users):
            last = self._notified.get(subscriber)
            if last is None or (has_recovered and last != why):
                self.notify_of_failure(subscriber, why)

    def notify_of_failure(self, subscriber: TopicClient, why: str) -> None:
        """Notify a client that shares it why it brings nothing for now."""
        self._notified[subscriber] = why
        subscriber.on_topic_failed(self.key.topic, why)

    def date_for(self, user: TopicClient) -> None:
        """Keep the age of messages bounded as long as this user shares the topic."""
        self._dated_for.add(user)
        self.is_dated.set()

    def on_left(self, user: TopicClient) -> None:
        """Keep nothing for a user that shares it no more."""
        self.newcomers.pop(user, None)
        self._notified.pop(user, None)
        self._dated_for.discard(user)
        if not self._dated_for:
            self.is_dated.clear()

    def sent_since_s(self) -> float | None:
        """Return since when a message that comes now can have been under way, of time.monotonic(); None: unknown."""
        timestamps = self.timestamps
        return None if timestamps is None else timestamps.of(None, time.monotonic())

    def by_digest(self) -> dict[str, tuple[bytes, WSMsgType]]:
        """Return the messages that newcomers may get, by digest."""
        return {digest(message.data): (message.data, message.kind) for message in self._remembered}

    def lasting(self) -> list[tuple[bytes, WSMsgType]]:
        """Return the messages that newcomers get without a question, which may have to wait."""
        # By its name all that was published lasts.
        is_static = self.key.topic.endswith("/tf_static")
        return list(self.by_digest().values()) if is_static else self.repeated

    @property
    def newest(self) -> ReceivedMessage | None:
        """The message that came last, if any did."""
        return self._remembered[-1] if self._remembered else None

    @property
    def large_bytes(self) -> int:
        """The size of the newest message if it is a large one."""
        is_large = self._remembered_bytes > MAX_REMEMBERED_BYTES
        return self._remembered_bytes if is_large else 0

    def _note_received(self, received: str) -> None:
        """Repeat no message that equals one which came since: newcomers have that, and would get it twice."""
        for missed in (*self.newcomers.values(), *self.asking.values()):
            missed.discard(received)

    def _remember(self, message: bytes, kind: WSMsgType) -> None:
        remembered = self._remembered
        self.message_count += 1
        self.is_unkept = not self._has_room(len(message))
        if self.is_unkept:
            # An older one must not pass for the newest.
            remembered.clear()
            self._remembered_bytes = 0
            return
        remembered.append(
            ReceivedMessage(message, kind, self._clock(), self._name, self.message_count)
        )
        self._remembered_bytes += len(message)
        while len(remembered) > MAX_KNOWN or (
            self._remembered_bytes > MAX_REMEMBERED_BYTES and len(remembered) > 1
        ):
            self._remembered_bytes -= len(remembered.popleft().data)

    def _has_room(self, size: int) -> bool:
        """Return whether a message may be kept; what is already kept of others stays, as it may never come again."""
        if size <= MAX_REMEMBERED_BYTES:
            return True
        others = sum(topic.large_bytes for topic in self._all_of_robot() if topic is not self)
        return others == 0 or others + size <= MAX_LARGE_BYTES


class TopicRefusedError(RobotetherError):
    """The robot sends as many topics as may be, or this person alone has as many as one may."""


class TopicConnector(Protocol):
    """What brings topics their messages."""

    async def run(self, topic: SharedTopic) -> None:
        """Bring its messages until this is cancelled, and say when rosbridge has the subscription."""

    def repeat(self, topic: SharedTopic, digests: Collection[str]) -> AsyncIterator[str]:
        """Yield the digest of each of those messages that rosbridge repeats to a newcomer, once, as it does."""


class SharedTopics(SharedCopies[SharedTopic]):
    """All shared topics, by robot and subscription."""

    def __init__(self, registry: SessionRegistry, connector: TopicConnector) -> None:
        super().__init__(registry, attrgetter("topics"), max_lingering=MAX_TOPICS)
        self._connector = connector

    def join(
        self, robot: RelayRobot, subscription: TopicRequest, subscriber: TopicClient, limit: int
    ) -> SharedTopic:
        """Share a topic, with what a newcomer missed; raise TopicRefusedError for a new one beyond the limit."""
        topic = self.watch(robot, subscription, subscriber, limit)
        self.give_missed(topic, subscriber)
        return topic

    def give_missed(self, topic: SharedTopic, subscriber: TopicClient) -> None:
        """Give a client that shares it what rosbridge repeats to each new subscription, also to a client's second."""
        topic.has_newcomer.set()
        if topic.failure is not None:
            topic.notify_of_failure(subscriber, topic.failure)
        elif topic.is_unkept:
            subscriber.on_topic_failed(topic.key.topic, UNKEPT)
        elif lasting := topic.lasting():
            for message in lasting:
                subscriber.on_message(topic.key.topic, *message)
        elif by_digest := topic.by_digest():
            topic.newcomers[subscriber] = set(by_digest)
            if not topic.is_asked_for:
                topic.is_asked_for = True
                self._start(self._repeat(topic))

    def watch(
        self, robot: RelayRobot, subscription: TopicRequest, subscriber: TopicClient, limit: int
    ) -> SharedTopic:
        """Share a topic as `join` does, without asking the robot what a newcomer missed."""
        topics = self._of(robot.id)
        topic = topics.get(subscription)
        if topic is None:
            if limit == MAX_OBSERVED_TOPICS:
                self._check_share(robot, subscriber)
            if len(topics) >= limit and not self._end_any_unused(robot.id):
                raise TopicRefusedError(f"{robot.name} sends {limit} topics already")
            all_of_robot = partial(self._topics_of, robot.id)
            topic = self._open(SharedTopic(robot, subscription, all_of_robot))
        topic.users.add(subscriber)
        topic.has_newcomer.set()
        return topic

    def leave(
        self, topic: SharedTopic, subscriber: TopicClient, linger_s: float = LINGER_S
    ) -> None:
        """Share it no more; the last one's leaving ends it after a while."""
        topic.users.discard(subscriber)
        topic.on_left(subscriber)
        self._let_linger(topic, linger_s)

    def _check_share(self, robot: RelayRobot, subscriber: TopicClient) -> None:
        """Raise TopicRefusedError when a person would leave the other observers too few topics."""
        user_ids = set(subscriber.user_ids())
        users = [topic.user_ids() for topic in self._topics_of(robot.id) if topic.users]
        # Those of another cell are nobody's until it has said whose they are.
        own = sum(bool(each) and each <= user_ids for each in users)
        left = MAX_OBSERVED_TOPICS - len(users)
        if 0 < left * OWN_FOR_EACH_LEFT <= own:
            raise TopicRefusedError(
                f"you alone have {own} of the {MAX_OBSERVED_TOPICS} topics that observers of {robot.name}"
                " may have, and the rest is for others"
            )

    def _topics_of(self, robot_id: int) -> list[SharedTopic]:
        return list(self._of(robot_id).values())

    async def _bring(self, copy: SharedTopic) -> None:
        try:
            await self._turn_to_open(copy)
            with self._registry.ensure_robot(copy.robot.id).media_demand.counted():
                await self._connector.run(copy)
        except Exception:
            log.exception("robot %s: a topic failed", copy.robot.name)
            copy.on_failed("the relay failed")

    async def _turn_to_open(self, topic: SharedTopic) -> None:
        """Wait while the robot has opened many topics lately, as of one who subscribes anew without end."""
        limiter = self._registry.ensure_robot(topic.robot.id).topic_opens
        while not limiter.allow(time.monotonic()):  # noqa: ASYNC110 - time alone makes room
            await asyncio.sleep(limiter.free_in_s(time.monotonic()))

    async def _repeat(self, topic: SharedTopic) -> None:
        """Give newcomers what rosbridge repeats: whoever comes during a question shares the next."""
        try:
            while topic.newcomers:
                await self._turn_to_open(topic)
                topic.asking, topic.newcomers = topic.newcomers, {}
                await self._repeat_to_asking(topic)
        finally:
            topic.asking = {}
            topic.is_asked_for = False

    async def _repeat_to_asking(self, topic: SharedTopic) -> None:
        by_digest, lasting, repeated = topic.by_digest(), topic.repeated, list[str]()

        def give(digests: Collection[str]) -> None:
            for subscriber, missed in topic.asking.items():
                for each in digests:
                    if subscriber in topic.users and each in missed:
                        missed.remove(each)
                        subscriber.on_message(topic.key.topic, *by_digest[each])

        async for each in self._connector.repeat(topic, by_digest.keys()):
            repeated.append(each)
            asyncio.get_running_loop().call_later(REPEAT_AFTER_S, give, (each,))
        if repeated:
            await asyncio.sleep(REPEAT_AFTER_S)
        lasting[:] = [by_digest[each] for each in repeated]
        if topic.repeated:
            topic.asking |= topic.newcomers
            topic.newcomers = {}
        give(repeated)
