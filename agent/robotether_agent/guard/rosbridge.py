"""The guard's own connection to rosbridge, for its commands and zeros, in order.

The guard's process runs `CmdVelPublisher` for its whole life; it connects again at once and for ever. Nothing waits in
it: `can_send` says whether what is sent now is read soon. TCP alone does not show it, for the kernel buffers minutes of
commands for a rosbridge that reads nothing, and delivers them when it reads again. So a ping follows each command, and
while its pong is late nothing is sent.

`SubscriberWatch` asks rosapi who listens to what is driven, on a connection of its own: a rosapi that hangs must delay
neither a command nor a zero.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Callable
from typing import NoReturn, Protocol

import aiohttp
from aiohttp import ClientSession, WSMsgType

from robotether_agent.describe_error import describe_error
from robotether_agent.fields import JsonObject
from robotether_agent.rosbridge import Rosbridge, connected
from robotether_agent.rosbridge_socket import CONNECT_WITHIN_S, RosbridgeSocket, open_rosbridge
from robotether_agent.tasks import within

RETRY_S = 0.2
# Size of the kernel's buffer of the publisher; the minimum is some 4 KB, twenty commands.
KERNEL_BUFFER_BYTES = 4096
# Maximum delay of a pong before the connection counts as full.
FULL_AFTER_S = 0.1
# Maximum delay of a pong before rosbridge counts as not reading.
STALLED_AFTER_S = 0.5
GIVEN_UP_AFTER_S = 10.0
IDLE_PING_EVERY_S = 1.0
WATCH_EVERY_S = 1.0
# Interval before the next question to a rosapi that did not answer.
SILENT_ROSAPI_S = 10.0
ROSAPI_WITHIN_S = 3.0
# Maximum size of an answer: the nodes of one topic.
MAX_NODES_BYTES = 64 * 1024

log = logging.getLogger(__name__)


class PublisherListener(Protocol):
    """The user of the connection, which is notified of what happens on it. Must not wait."""

    def on_rosbridge_connected(self) -> None:
        """Rosbridge answers again."""

    def on_rosbridge_lost(self) -> None:
        """Rosbridge is gone; what was sent last may not have arrived."""

    def on_rosbridge_drained(self) -> None:
        """What was sent is read."""

    def on_rosbridge_message(self, data: bytes) -> None:
        """Rosbridge answers a command, with a status."""


class CmdVelPublisher:
    """One connection after the other."""

    def __init__(self, http: ClientSession, clock: Callable[[], float]) -> None:
        self._http = http
        self._clock = clock
        self.read_until = 0.0
        self._url = ""
        self._has_url = asyncio.Event()
        self._socket: RosbridgeSocket | None = None
        self._pinged_at: float | None = None
        self._sent_since_ping = False
        # What the log says last; None: nothing yet.
        self._logged_up: bool | None = None

    @property
    def up(self) -> bool:
        """Whether rosbridge is there and reads."""
        return self._socket is not None and not self.stalled

    @property
    def stalled(self) -> bool:
        """Whether rosbridge is connected and reads nothing."""
        return self._waits(STALLED_AFTER_S)

    @property
    def can_send(self) -> bool:
        """Whether what is sent now is read soon."""
        connection = self._socket
        if connection is None or connection.closed or self._waits(FULL_AFTER_S):
            return False
        return connection.waiting_bytes() == 0

    def use(self, url: str) -> None:
        """Connect to this rosbridge, which is the same for an agent's whole life."""
        self._url = url
        self._has_url.set()

    async def send(self, data: bytes) -> bool:
        """Send one message; ask `can_send` first. False: the connection is gone."""
        connection = self._socket
        if connection is None:
            return False
        try:
            await connection.send_frame(data, WSMsgType.TEXT)
            self._sent_since_ping = True
            if self._pinged_at is None:
                await self._ping(connection)
        except ConnectionError:
            return False
        return True

    async def run(self, listener: PublisherListener) -> NoReturn:
        """Keep the connection, without end; notify the listener of what happens on it."""
        await self._has_url.wait()
        while True:
            try:
                await self._connection(listener)
            except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
                self._log_down(describe_error(error, CONNECT_WITHIN_S))
            await asyncio.sleep(RETRY_S)

    async def _connection(self, listener: PublisherListener) -> None:
        connection = await open_rosbridge(self._http, self._url)
        _keep_small(connection)
        self._socket, self._pinged_at, self._sent_since_ping = connection, None, False
        pinger = asyncio.ensure_future(self._ping_on(connection))
        try:
            listener.on_rosbridge_connected()
            await self._read(connection, listener)
        finally:
            self._socket = None
            pinger.cancel()
            connection.drop()
            listener.on_rosbridge_lost()
            await asyncio.gather(pinger, return_exceptions=True)
        self._log_down("it closed the connection")

    async def _read(self, connection: RosbridgeSocket, listener: PublisherListener) -> None:
        while True:
            message = await connection.receive()
            if message.type is WSMsgType.PONG:
                await self._ponged(connection)
                listener.on_rosbridge_drained()
            elif message.type is WSMsgType.PING:
                await connection.pong(message.data)
            elif message.type is WSMsgType.TEXT:
                listener.on_rosbridge_message(message.data)
            elif message.type is not WSMsgType.BINARY:
                return

    async def _ponged(self, connection: RosbridgeSocket) -> None:
        if self._pinged_at is not None:
            self.read_until = self._pinged_at
        # Not before: a rosbridge that closes each connection at once would fill the log.
        if not self._logged_up:
            self._logged_up = True
            log.info("rosbridge at %s answers the publisher", self._url)
        self._pinged_at = None
        if self._sent_since_ping:
            await self._ping(connection)

    async def _ping_on(self, connection: RosbridgeSocket) -> None:
        """Ping also while nobody drives, so that the first command does not find a dead line."""
        while True:
            await asyncio.sleep(IDLE_PING_EVERY_S)
            if self._waits(GIVEN_UP_AFTER_S):
                log.warning(
                    "rosbridge answered no ping for %g s; connecting again", GIVEN_UP_AFTER_S
                )
                connection.drop()
                return
            if self._pinged_at is None:
                await self._ping(connection)

    async def _ping(self, connection: RosbridgeSocket) -> None:
        self._pinged_at, self._sent_since_ping = self._clock(), False
        await connection.ping()

    def _waits(self, seconds: float) -> bool:
        return self._pinged_at is not None and self._clock() - self._pinged_at > seconds

    def _log_down(self, reason: str) -> None:
        if self._logged_up is not False:
            self._logged_up = False
            log.warning("the publisher to rosbridge at %s is down: %s", self._url, reason)


class WatchListener(Protocol):
    """The publisher on drive topics, which is notified of who listens to them. Must not wait."""

    def driven_now(self) -> list[str]:
        """Name the topics that somebody drives, and that rosbridge has had time to register."""

    def on_unheard(self, names: frozenset[str] | None, *, is_sure: bool = True) -> None:
        """Nothing listens to these topics, as far as is known; None: rosapi said who listens, and no longer answers.

        It is not sure on ROS 2: rosapi names nodes, and neither programs of plain DDS nor nodes of some other releases
        (ros2/ros2#1604).
        """

    def on_unregistered(self, name: str) -> None:
        """ROS does not know any more that rosbridge publishes this topic."""


class SubscriberWatch:
    """Asks who listens to the driven topics, while there are any.

    ROS 1's rosbridge registers a topic once: the next master does not know of it, and no command reaches anybody. Nor
    does the next master know of rosapi, which then says nothing more.
    """

    def __init__(self, listener: WatchListener, url: Callable[[], str]) -> None:
        self._listener = listener
        self._url = url
        # Topics of which rosapi has known a publisher.
        self._published: set[str] = set()
        # None: not known yet.
        self._is_ros_2: bool | None = None

    async def run(self) -> None:
        """Watch, without end."""
        while True:
            await asyncio.sleep(WATCH_EVERY_S)
            try:
                await self._watch()
            except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
                log.debug("cannot ask who listens: %r", error)
                # That rosbridge is gone is known otherwise.
                is_silent = isinstance(error, asyncio.TimeoutError)
                self._listener.on_unheard(self._unknown() if is_silent else frozenset())
                await asyncio.sleep(SILENT_ROSAPI_S)

    async def _watch(self) -> None:
        if self._listener.driven_now():
            async with connected(self._url(), max_message_bytes=MAX_NODES_BYTES) as rosbridge:
                while names := self._listener.driven_now():
                    answers = {name: await self._is_unheard(rosbridge, name) for name in names}
                    unheard = frozenset(name for name in names if answers[name])
                    is_known = unheard or None not in answers.values()
                    self._listener.on_unheard(
                        unheard if is_known else self._unknown(), is_sure=not self._is_ros_2
                    )
                    await asyncio.sleep(WATCH_EVERY_S)
        self._listener.on_unheard(frozenset())

    def _unknown(self) -> frozenset[str] | None:
        """Return what is reported without an answer: a robot without rosapi never had one."""
        return None if self._published else frozenset()

    async def _is_unheard(self, rosbridge: Rosbridge, name: str) -> bool | None:
        """Whether rosapi knows of a publisher and of no subscriber, or of no publisher any more.

        None: rosapi does not say, or only who publishes listens. That is rosbridge, for a base that it connects, or for
        an observer.
        """
        publishers = await self._nodes(rosbridge, "publishers", name)
        subscribers = await self._nodes(rosbridge, "subscribers", name)
        if publishers is None or subscribers is None:
            return None
        if publishers:
            self._published.add(name)
            if self._is_ros_2 is None:
                ros_type = (await self._ask_rosapi(rosbridge, "topic_type", name)).get("type")
                if isinstance(ros_type, str) and ros_type:
                    self._is_ros_2 = "/msg/" in ros_type
            if subscribers and all(node in publishers for node in subscribers):
                return None
            return not subscribers
        # A rosapi that hides this topic has never listed a publisher.
        if name not in self._published:
            return False
        if not self._is_ros_2:
            self._listener.on_unregistered(name)
        return True

    async def _nodes(self, rosbridge: Rosbridge, kind: str, topic: str) -> list[object] | None:
        """Return the publishers or subscribers of a topic; None: rosapi does not say."""
        nodes = (await self._ask_rosapi(rosbridge, kind, topic)).get(kind)
        return nodes if isinstance(nodes, list) else None

    async def _ask_rosapi(self, rosbridge: Rosbridge, kind: str, topic: str) -> JsonObject:
        answer: JsonObject = await within(
            ROSAPI_WITHIN_S, rosbridge.call(f"/rosapi/{kind}", {"topic": topic})
        )
        return answer


def _keep_small(connection: RosbridgeSocket) -> None:
    raw = connection.get_extra_info("socket")
    if raw is not None:
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, KERNEL_BUFFER_BYTES)
