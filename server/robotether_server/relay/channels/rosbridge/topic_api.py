"""Answers GET /api/v1/robots/NAME/topics/TOPIC: the newest message of a topic, or the next one.

It shares the one copy of the topic with all who request the same, as a subscriber for as long as it waits. The copy
stays a while, so that a program that polls subscribes once.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from functools import partial
from weakref import WeakKeyDictionary

from aiohttp import WSMsgType, web
from msgspec import UNSET, Raw, Struct, UnsetType

from robotether_server import schemas
from robotether_server.contract.ros import TopicAnswer, TopicQuery
from robotether_server.problems import TooManyConnectionsError, TopicDownError
from robotether_server.relay.auth.access import request_of
from robotether_server.relay.channels.rosbridge.http_calls import (
    HttpCalls,
    check_message,
    read_raw,
)
from robotether_server.relay.channels.rosbridge.shared_topics import (
    MAX_OBSERVED_TOPICS,
    UNKEPT,
    ReceivedMessage,
    SharedTopic,
    SharedTopics,
    TopicRefusedError,
    TopicRequest,
)
from robotether_server.relay.robots.connection import Connection

# Time for which a topic's copy stays after a request.
POLLED_LINGER_S = 5.0


class RosbridgeMessage(Struct):
    """What rosbridge sends of a topic, or to whom it cannot."""

    op: str
    msg: Raw | UnsetType = UNSET
    level: str = ""


class TopicPoll:
    """Waits for a message of a topic; implements `shared_topics.TopicClient`."""

    def __init__(self, user_id: int) -> None:
        self._user_id = user_id
        self._changed = asyncio.Event()

    def user_ids(self) -> set[int]:
        """Return who waits."""
        return {self._user_id}

    def on_topic_ready(self, topic: str) -> None:
        """The robot's rosbridge has the subscription: a message may come."""

    def on_message(self, topic: str, message: bytes, kind: WSMsgType) -> None:
        """A message of a topic came."""
        self._changed.set()

    def on_topic_failed(self, topic: str, why: str) -> None:
        """The topic brings nothing for now."""
        self._changed.set()

    async def message(self, topic: SharedTopic, since: object) -> tuple[ReceivedMessage, Raw]:
        """Wait for a message other than this one; return the newest with its content."""
        name = topic.key.topic
        while True:
            if (why := UNKEPT if topic.is_unkept else topic.failure) is not None:
                raise TopicDownError(f"cannot read {name}: {why}")
            newest = topic.newest
            if newest is not None and newest.sequence != since:
                if (content := _content(name, newest)) is not None:
                    return newest, content
                since = newest.sequence
            self._changed.clear()
            await self._changed.wait()


@dataclass(frozen=True)
class TopicApi:
    """Answers GET /api/v1/robots/NAME/topics/TOPIC."""

    calls: HttpCalls
    shared_topics: SharedTopics

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Answer with the newest message; 204 when none comes in time."""
        access, name = self.calls.context.access, request.match_info["name"]
        permit = await access.for_topic(request_of(request), name)
        query = schemas.read_query(request.query.items(), TopicQuery)
        message = {
            "op": "subscribe",
            "topic": request.match_info["topic"],
            "type": query.type,
            "throttle_rate": query.throttle_rate,
        }
        checked = check_message(permit.robot, permit.level, message)
        self.calls.context.registry.online_presence(permit.robot)
        work = partial(self._newest, TopicRequest.of(checked.subscription or {}), query)
        return await self.calls.answer(request, permit, "observe", work)

    async def _newest(
        self, topic_request: TopicRequest, query: TopicQuery, connection: Connection
    ) -> TopicAnswer | None:
        poll, robot = TopicPoll(connection.user_id), connection.robot
        try:
            topic = self.shared_topics.watch(robot, topic_request, poll, MAX_OBSERVED_TOPICS)
        except TopicRefusedError as refused:
            raise TooManyConnectionsError(
                f"cannot read {topic_request.topic}: {refused.detail}"
            ) from refused
        try:
            async with asyncio.timeout(query.wait_s):
                message, content = await poll.message(topic, query.since)
        except TimeoutError:
            return None
        finally:
            self.shared_topics.leave(topic, poll, POLLED_LINGER_S)
        age_s = asyncio.get_running_loop().time() - message.received_s
        return TopicAnswer(topic_request.topic, round(age_s, 4), message.sequence, content)


# A large message takes 20 ms to read, in which drivers wait: each is read once for all.
_contents: WeakKeyDictionary[ReceivedMessage, Raw] = WeakKeyDictionary()


def _content(topic: str, topic_message: ReceivedMessage) -> Raw | None:
    """Return the ROS message in one of rosbridge's; None when it is not a message of a topic."""
    if (content := _contents.get(topic_message)) is not None:
        return content
    message = read_raw(topic_message.data, RosbridgeMessage)
    if message is None:
        raise TopicDownError(f"cannot read {topic}: the robot sends what is not JSON")
    if message.op == "publish" and message.msg is not UNSET:
        _contents[topic_message] = message.msg
        return message.msg
    if message.op == "status" and message.level == "error":
        raise TopicDownError(f"cannot read {topic}: rosbridge reports {_words(message.msg)}")
    return None


def _words(msg: Raw | UnsetType) -> str:
    text = b"" if msg is UNSET else bytes(msg)
    return repr(text.decode(errors="replace")[:200].strip('"'))
