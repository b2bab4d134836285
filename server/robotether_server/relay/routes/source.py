"""The source of one route: the newest message of a topic, with the time since when it may be under way.

It shares the one copy of a robot's topic as an observer does, or gets the messages from the cell that has the robot
(`cell_sources`), or from an app (`apps`). `driver` or an app takes messages from here, at most at the route's rate;
what comes in between is replaced by what comes next.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable, Coroutine
from typing import Any, NamedTuple

from aiohttp import WSMsgType

from robotether_server.db.fleet import RelayRobot
from robotether_server.db.routes import RelayRoute
from robotether_server.relay.channels.rosbridge.http_calls import check_message
from robotether_server.relay.channels.rosbridge.operations import NotJsonError, read_json
from robotether_server.relay.channels.rosbridge.shared_topics import (
    MAX_STANDING_TOPICS,
    SharedTopic,
    SharedTopics,
    TopicRequest,
)
from robotether_server.robot_json import without_nan

# Minimum interval between looks for messages that wait.
LOOK_EVERY_S = 0.005
# Time over which the rate of a route is measured.
RATE_OVER_S = 2.0
MAX_TIMES = 1000
# Maximum length of a robot's own words for why it brings or takes nothing.
MAX_WORDS = 200


class SourceMessage(NamedTuple):
    """A message as rosbridge sent it, and since when it may be under way, of time.monotonic(); None: unknown."""

    data: bytes
    since_s: float | None


class RouteSource:
    """Implements `shared_topics.TopicClient`. `is_drive`: the route's target is a drive topic."""

    def __init__(
        self, route: RelayRoute, wake: Callable[[], None], *, is_drive: bool, rules: object = None
    ) -> None:
        self.route = route
        # Where and by what it may read; when that changes, it is opened anew.
        self.rules = rules
        self.is_drive = is_drive
        self.is_advertised = False
        # From where the app connects, if it reads one and this is known.
        self.address: str | None = None
        # By time.monotonic(): until when its commands may move a robot that an app drives.
        self.moves_until_s = 0.0
        # By time.monotonic(): when the next message may go.
        self.free_at_s = 0.0
        # Why the newest message went nowhere, or none comes; empty: none of it.
        self.problem = ""
        self._wake = wake
        self._newest: SourceMessage | None = None
        self._shared: SharedTopic | None = None
        self._leave_app: Callable[[RouteSource], None] | None = None
        self._bringing: asyncio.Task[None] | None = None
        self._sent_at: deque[float] = deque(maxlen=MAX_TIMES)

    def open(self, robot: RelayRobot, shared_topics: SharedTopics) -> None:
        """Share the topic; raise the problem when the robot's policy does not allow it, or it sends too many topics.

        The robot is here. A drive topic gets no message that rosbridge repeats to newcomers: that is an old command.
        Nor is anything throttled at its robot, where the last one, which stops, could be the one that is left out.
        """
        request = self.request(robot)
        self._shared = shared_topics.watch(robot, request, self, MAX_STANDING_TOPICS)
        if self.is_drive:
            self._shared.date_for(self)
            self.problem = self._shared.failure or ""
        else:
            shared_topics.give_missed(self._shared, self)

    def request(self, robot: RelayRobot) -> TopicRequest:
        """Return what it subscribes to; raise the problem when the robot's policy does not allow it."""
        route = self.route
        message: dict[str, object] = {
            "op": "subscribe",
            "topic": route.source_topic,
            "type": route.type,
        }
        if not self.is_drive:
            message |= {"throttle_rate": int(1000 / route.rate_hz), "queue_length": 1}
        checked = check_message(robot, "manage", message)
        return TopicRequest.of(checked.subscription or {})

    def bring(
        self,
        messages: Callable[[RouteSource], Coroutine[Any, Any, None]],
        address: str | None = None,
    ) -> None:
        """Get the messages from the cell of the robot or the app, which connects from an address."""
        self.address = address
        self._bringing = asyncio.create_task(messages(self), name=f"route {self.route.id}")

    def follow(
        self,
        read: Callable[[RouteSource], None],
        leave: Callable[[RouteSource], None],
        address: str | None,
    ) -> None:
        """Get the messages from an app, which has these two, and connects from an address."""
        self._leave_app, self.address = leave, address
        read(self)

    def close(self, shared_topics: SharedTopics) -> None:
        """Share it no more."""
        if self._shared is not None:
            shared_topics.leave(self._shared, self)
        if self._leave_app is not None:
            self._leave_app(self)
        if self._bringing is not None:
            self._bringing.cancel()
        self._shared = self._newest = self._bringing = None

    def user_ids(self) -> set[int]:
        """Return whose route it is."""
        return {self.route.user_id}

    def on_message(self, topic: str, message: bytes, kind: WSMsgType) -> None:
        """A message came; it takes the place of one that waits."""
        if kind is WSMsgType.TEXT and self._shared is not None:
            self.receive(SourceMessage(message, self._shared.sent_since_s()))

    def receive(self, message: SourceMessage) -> None:
        """Have this go next, in place of one that waits."""
        self._newest = message
        self._wake()

    def on_topic_ready(self, topic: str) -> None:
        """The robot's rosbridge has the subscription."""
        self.problem = ""

    def on_topic_failed(self, topic: str, why: str) -> None:
        """The topic brings nothing for now."""
        self.problem = why

    def due_in_s(self, now_s: float) -> float | None:
        """Return in how many seconds a message is due; None: none waits."""
        return None if self._newest is None else max(0.0, self.free_at_s - now_s)

    def take(self, now_s: float) -> SourceMessage | None:
        """Return the message that waits, and wait with the next one as the rate says."""
        message, self._newest = self._newest, None
        interval_s = 1 / self.route.rate_hz
        # One that comes a little early or late keeps its place.
        self.free_at_s = max(self.free_at_s, now_s - interval_s / 2) + interval_s
        return message

    def forget_before(self, time_s: float) -> None:
        """Have what waits go nowhere, unless it was sent after this time."""
        newest = self._newest
        if newest is not None and (newest.since_s is None or newest.since_s < time_s):
            self._newest = None

    def content(self, data: bytes, *, may_hold_null: bool = False) -> dict[str, Any] | None:
        """Return the ROS message in one of rosbridge's; None when it is another, which may say why none comes.

        `may_hold_null`: the target takes null for a number that is NaN or infinite, as no rosbridge does.
        """
        finite = without_nan(data)
        if finite != data and not may_hold_null:
            self.problem = "a number in the message is NaN or infinite, which no robot reads"
            return None
        try:
            message = read_json(finite)
        except NotJsonError as problem:
            self.problem = f"the source sends what is not JSON: {problem}"
            return None
        if message.get("op") == "publish":
            content = message.get("msg")
            return content if isinstance(content, dict) else None
        self.problem = words_of_error(message) or self.problem
        return None

    def on_sent(self, now_s: float) -> None:
        """A message went to the target."""
        self._sent_at.append(now_s)
        self.problem = ""

    def rate_hz(self) -> float:
        """Return how many messages a second went to the target lately."""
        since_s = time.monotonic() - RATE_OVER_S
        return round(sum(sent_at > since_s for sent_at in self._sent_at) / RATE_OVER_S, 1)


def words_of_error(message: dict[str, Any]) -> str:
    """Return what a robot's rosbridge or guard complains of; empty: it does not."""
    if message.get("op") != "status" or message.get("level") != "error":
        return ""
    words = message.get("msg")
    return words[:MAX_WORDS] if isinstance(words, str) and words.isprintable() else "it failed"
