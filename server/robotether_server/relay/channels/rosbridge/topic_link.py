"""The WebSocket to a robot's topics service, or to its cell, from which one shared topic gets its messages.

`shared_topics` runs one a topic. It opens the connection, opens it again when it breaks, and waits longer each time
while that fails.
"""

from __future__ import annotations

import asyncio
import logging
import re
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Coroutine
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from aiohttp import ClientError, WebSocketError, WSCloseCode, WSMsgType
from aiohttp.http_websocket import WSMessageNoDecodeText
from msgspec import Struct
from robotether_common.topics import KNOWN, KNOWN_OP, MAX_KNOWN, PATH

from robotether_server.db.fleet import RelayRobot
from robotether_server.problems import RobotetherError
from robotether_server.relay.channels.rosbridge.drive_path import CommandTimestamps
from robotether_server.relay.channels.rosbridge.forwarded_topics import (
    FailureNotice,
    read_notice,
)
from robotether_server.relay.channels.rosbridge.operations import NotJsonError, read_json
from robotether_server.relay.channels.rosbridge.shared_topics import SharedTopic
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import ConnectionClosedError
from robotether_server.relay.http.sockets import RobotSocket, own_words
from robotether_server.relay.robots.demand import OPENS_WITHIN_S
from robotether_server.relay.robots.media_dialer import MediaPath
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.robot_json import read_robot_json
from robotether_server.tasks import end_tasks
from robotether_server.times import delays

log = logging.getLogger(__name__)

FIRST_PAUSE_S, MAX_PAUSE_S = 0.2, 30.0
# Time after which a connection counts as stable, and one on which no message came: it may break at the first one each
# time, which takes long on a narrow line.
STEADY_S, SILENT_STEADY_S = 10.0, 600.0
# Pauses after a message over the limit: the next one mostly is, too, and rosbridge does nothing else while it writes.
FIRST_LARGE_PAUSE_S, MAX_LARGE_PAUSE_S = 30.0, 600.0
# Times after which a newcomer has a subscription made anew that has brought nothing. rosbridge_suite silently drops one
# without a type while nobody advertises the topic, and never repeats a message that was latched after the subscription.
FIRST_SILENCE_S, MAX_SILENCE_S = 5.0, 60.0
# aiohttp's words for a message over the limit, which it refuses by the size that is announced.
ANNOUNCED = re.compile(r"Message size (\d+)")
MEGABYTE = 1024 * 1024
# Maximum size of what rosbridge reports of a subscription; a message may be far larger.
MAX_STATUS_BYTES = 16 * 1024
# Interval between pings that bound the age of messages: an age is at most this and a round trip too high.
DATED_EVERY_S = 0.1
# Time limit for what a robot repeats to a newcomer.
REPEATED_WITHIN_S = 5.0


class MessageTooLargeError(RobotetherError):
    """A message of a topic is over the limit."""


class Pauses:
    """Pauses before a topic is requested again: each is longer than the one before, until it brings something."""

    def __init__(self) -> None:
        self._restart()

    def next(self, lasted_s: float, *, has_brought: bool, is_too_large: bool) -> float:
        """Return the pause after a connection of this length in seconds."""
        if lasted_s > (STEADY_S if has_brought else SILENT_STEADY_S):
            self._restart()
        return next(self._large if is_too_large else self._usual)

    def _restart(self) -> None:
        self._usual = delays(FIRST_PAUSE_S, MAX_PAUSE_S)
        self._large = delays(FIRST_LARGE_PAUSE_S, MAX_LARGE_PAUSE_S)


# Opens a WebSocket to a robot's topics service within a time; raises ConnectionClosedError when there is none.
OpenTopic = Callable[[RelayRobot, MediaPath, float], Awaitable[RobotSocket]]


@dataclass(frozen=True)
class TopicLinks:
    """The way to all robots' topics; implements `shared_topics.TopicConnector`."""

    open_topic: OpenTopic
    registry: SessionRegistry
    message_limit: int
    # With it begins what a robot's cell notifies this one of.
    notices_key: bytes

    async def run(self, topic: SharedTopic) -> None:
        """Bring a topic's messages until this is cancelled."""
        pauses, silences = Pauses(), delays(FIRST_SILENCE_S, MAX_SILENCE_S)
        while True:
            opened_s, count_before, is_too_large = time.monotonic(), topic.message_count, False
            try:
                why = await self._bring(topic, next(silences))
                if why is None:
                    continue
            except MessageTooLargeError as error:
                why, is_too_large = error.detail, True
            except ConnectionClosedError as closed:
                why = closed.close_reason.reason
            except (ClientError, OSError):
                why = "the connection broke"
            topic.on_failed(why)
            log.info("robot %s: topic %s: %s", topic.robot.name, topic.key.topic, why)
            lasted_s, has_brought = time.monotonic() - opened_s, topic.message_count > count_before
            if has_brought:
                silences = delays(FIRST_SILENCE_S, MAX_SILENCE_S)
            pause_s = pauses.next(lasted_s, has_brought=has_brought, is_too_large=is_too_large)
            await asyncio.sleep(pause_s)

    async def repeat(self, topic: SharedTopic, digests: Collection[str]) -> AsyncIterator[str]:
        """Yield the digest of each of those messages that rosbridge repeats to a newcomer, once, as it does."""
        unnamed = set(digests)
        try:
            async with asyncio.timeout(REPEATED_WITHIN_S) as limit:
                socket = await self._open(topic, {KNOWN: ",".join(digests)})
            try:
                # A robot may name one again and again.
                for _ in range(MAX_KNOWN):
                    async with asyncio.timeout_at(limit.when()):
                        message = await socket.receive()
                    if (name := _name_in(message)) not in digests:
                        break
                    if name in unnamed:
                        unnamed.remove(name)
                        yield name
            finally:
                socket.drop()
        except (ConnectionClosedError, ClientError, OSError) as error:
            log.debug("robot %s: cannot ask what it repeats: %r", topic.robot.name, error)

    async def _bring(self, topic: SharedTopic, silence_s: float) -> str | None:
        """Bring a topic's messages until the connection ends; return why, None if it brings nothing."""
        socket = await self._open(topic, {})
        uplink = self.registry.ensure_robot(topic.robot.id).uplink
        name = topic.key.topic
        timestamps = topic.timestamps = CommandTimestamps(time.monotonic())
        dating = asyncio.create_task(date(socket, topic.is_dated, timestamps))
        try:
            with uplink.counted("topic", name, socket.received_bytes, topic.user_ids):
                return await self._pass_on(socket, topic, silence_s)
        finally:
            topic.timestamps = None
            await end_tasks([dating])
            socket.drop()

    async def _pass_on(
        self, socket: RobotSocket, topic: SharedTopic, silence_s: float
    ) -> str | None:
        # It reads in order: its answer says that rosbridge has got the subscription before.
        await socket.ping()

        def on_control(kind: WSMsgType, payload: bytes) -> None:
            if kind is WSMsgType.PONG:
                topic.on_ready()
                if topic.timestamps is not None:
                    topic.timestamps.pong(payload)

        has_brought = False
        while True:
            receiving = socket.next_message(on_control)
            message = await (receiving if has_brought else first(receiving, topic, silence_s))
            if message is None:
                return None
            is_binary = message.type is WSMsgType.BINARY
            if is_binary and message.data.startswith(self.notices_key):
                notice = read_notice(self.notices_key, message.data)
                if isinstance(notice, FailureNotice):
                    topic.on_failed(notice.why)
            elif is_binary or message.type is WSMsgType.TEXT:
                if not has_brought and (why := _refusal_in(message.data)) is not None:
                    # As of a topic that nobody advertises yet: it is requested again.
                    return why
                has_brought = True
                topic.on_message(message.data, message.type)
            else:
                return self._why_ended(message)

    def _why_ended(self, last: WSMessageNoDecodeText) -> str:
        """Return why a connection ended; raise MessageTooLargeError where it did by a message over the limit."""
        if last.type is WSMsgType.CLOSE:
            why = own_words(last.extra) or "rosbridge ended the subscription"
            if last.data == WSCloseCode.MESSAGE_TOO_BIG:
                raise MessageTooLargeError(why)
            return why
        self._check_size(last.data)
        return "the connection broke"

    def _check_size(self, error: object) -> None:
        """Raise MessageTooLargeError where a connection ended by a message over the limit."""
        if isinstance(error, WebSocketError) and error.code == WSCloseCode.MESSAGE_TOO_BIG:
            size, limit = ANNOUNCED.search(str(error)), f"{self.message_limit / MEGABYTE:g} MB"
            words = f"{int(size[1]) / MEGABYTE:.1f} MB, " if size else ""
            raise MessageTooLargeError(f"a message has {words}over {limit} (MESSAGE_LIMIT_MB)")

    async def _open(self, topic: SharedTopic, query: dict[str, str]) -> RobotSocket:
        unknown = close_reasons.topics_unknown(topic.robot.name)
        path = MediaPath(PATH, query, self.message_limit, unknown, close_reasons.topics_down)
        socket = await self.open_topic(topic.robot, path, OPENS_WITHIN_S)
        await socket.send_frame(topic.key.message(), WSMsgType.TEXT)
        return socket


async def first(
    receiving: Coroutine[Any, Any, WSMessageNoDecodeText], topic: SharedTopic, silence_s: float
) -> WSMessageNoDecodeText | None:
    """Return the first message; None: the topic is silent, and is requested anew for a newcomer.

    Never for who shares it already: what is published meanwhile is lost, and a topic may be silent for good reason.
    """

    async def silence() -> None:
        await asyncio.sleep(silence_s)
        topic.has_newcomer.clear()
        await topic.has_newcomer.wait()

    tasks: list[asyncio.Task[Any]] = [
        asyncio.create_task(receiving),
        asyncio.create_task(silence()),
    ]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        return tasks[0].result() if tasks[0].done() else None
    finally:
        await end_tasks(tasks)


async def date(
    socket: RobotSocket, is_needed: asyncio.Event, timestamps: CommandTimestamps
) -> None:
    """Ping, while somebody needs ages: a message behind the pong of the other end is younger than the ping."""
    # Why it broke is what is read next.
    with suppress(ConnectionError):
        while True:
            await is_needed.wait()
            if not socket.waiting_bytes():
                await socket.ping(timestamps.ping(time.monotonic()))
            await asyncio.sleep(DATED_EVERY_S)


def _name_in(message: WSMessageNoDecodeText) -> str:
    """Return the digest in a message of the topics service, empty when it is no such message."""
    if message.type is not WSMsgType.TEXT:
        return ""
    try:
        answer = read_json(message.data)
    except NotJsonError:
        return ""
    return str(answer.get("digest")) if answer.get("op") == KNOWN_OP else ""


class RosbridgeStatus(Struct):
    """What rosbridge reports."""

    op: str
    level: str = ""
    msg: str = ""


def _refusal_in(message: bytes) -> str | None:
    """Return why rosbridge refuses a subscription; None: this is a message of the topic."""
    if len(message) > MAX_STATUS_BYTES:
        return None
    try:
        status = read_robot_json(message, RosbridgeStatus)
    except (ValueError, RecursionError):
        return None
    is_refusal = status.op == "status" and status.level == "error"
    return f"rosbridge reports {status.msg[:200]!r}" if is_refusal else None
