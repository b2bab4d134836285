"""Reads what the rules judge, and asks the server for help over the session.

`HelpCaller` is run by the agent for its whole life, by the settings of the newest session. Each topic has a
subscription of its own, as the battery has; a silent or unreadable topic asks for nothing, except the navigation's. A
call waits, the newest of each source, until a session's server has read it.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import asdict
from functools import partial
from typing import Any, NoReturn

import aiohttp
from robotether_common.own_topics import own_topic
from robotether_common.session import Battery, HelpCall, HelpSource

from robotether_agent.fields import JsonObject
from robotether_agent.help.rules import HelpConfig, HelpRules, Point, call_in, position_in
from robotether_agent.rosbridge import Rosbridge, RosGraph, connected
from robotether_agent.tasks import first_of, within

TOPIC_TYPE = "std_msgs/String"
DIAGNOSTICS_TYPE = "diagnostic_msgs/DiagnosticArray"
ODOMETRY_TYPE = "nav_msgs/Odometry"
# In the robot's namespace, the best first.
USUAL_DIAGNOSTICS = ("diagnostics_agg", "diagnostics")
USUAL_ODOMETRY = ("odom", "odometry", "odometry/filtered")
MAX_MESSAGE_BYTES = 1024 * 1024
# Minimum interval between two messages of a topic; of what comes meanwhile the newest remains.
THROTTLE_MS = 500
# Interval between checks of what needs no topic, and of the navigation's silence.
CHECK_EVERY_S = 1.0
# Interval before a topic that is not there, or a rosbridge that is not, is tried again.
RETRY_S = 10.0
# Interval between two positions of a robot that somebody uses.
POSITION_EVERY_S = 1.0
# Time after which a position that was read is unknown again.
POSITION_HOLDS_S = 3.0
# Minimum interval between two messages to the server.
SEND_EVERY_S = 5.0

Send = Callable[[Mapping[str, object]], None]
# The guard's stop and who set it; None: it does not say.
StopState = tuple[bool | None, str]
FindTopic = Callable[[Mapping[str, str]], str | None]
OnMessage = Callable[[JsonObject, float], HelpCall | None]

log = logging.getLogger(__name__)


class HelpCaller:
    """Asks for help by topic and by rules; the rules remember over sessions what they have asked for."""

    def __init__(
        self,
        graph: RosGraph,
        stop_state: Callable[[], StopState],
        battery: Callable[[], Battery | None],
    ) -> None:
        self._graph = graph
        self._stop_state = stop_state
        self._battery = battery
        self._config = HelpConfig()
        self._rules = HelpRules(self._config)
        self._changed = asyncio.Event()
        # The newest call of each source that the server may not have read.
        self._waiting: dict[HelpSource, HelpCall] = {}
        self._has_calls = asyncio.Event()
        # Where the robot is, by the geofence's topic, and when that came; None: unknown.
        self._position: tuple[Point, float] | None = None
        self._has_position = asyncio.Event()

    def use(self, config: HelpConfig) -> None:
        """Follow other settings; the rules begin anew."""
        if config != self._config:
            self._config, self._rules = config, HelpRules(config)
            self._changed.set()

    async def watch(self) -> NoReturn:
        """Read topics and apply the rules, with or without a session."""
        while True:
            self._changed.clear()
            await first_of(self._changed.wait(), *self._readers())

    async def report(self, send: Send, until_read: Callable[[], Awaitable[None]]) -> NoReturn:
        """Send over one session what was asked for; `until_read` waits until the server has read it."""
        while True:
            await self._has_calls.wait()
            sent = dict(self._waiting)
            for call in sent.values():
                send({"type": "help", **asdict(call)})
            await until_read()
            for source, call in sent.items():
                if self._waiting[source] is call:
                    del self._waiting[source]
            if not self._waiting:
                self._has_calls.clear()
            await asyncio.sleep(SEND_EVERY_S)

    async def report_position(self, send: Send, is_used: Callable[[], bool]) -> NoReturn:
        """Send where the robot is, while somebody uses it and a geofence has it known."""
        while True:
            await self._has_position.wait()
            self._has_position.clear()
            if self._position is None or not is_used():
                continue
            (x, y), at = self._position
            if _now_s() - at < POSITION_HOLDS_S:
                send({"type": "position", "x": x, "y": y})
                await asyncio.sleep(POSITION_EVERY_S)

    def _on_pose(self, rules: HelpRules, message: JsonObject, now_s: float) -> HelpCall | None:
        point = position_in(message)
        self._position = None if point is None else (point, now_s)
        self._has_position.set()
        return rules.on_pose(message, now_s)

    def _readers(self) -> list[Coroutine[Any, Any, NoReturn]]:
        config, rules = self._config, self._rules
        readers: list[Coroutine[Any, Any, NoReturn]] = []
        if (topic := config.topic) is not None:
            read = partial(self._read, topic, TOPIC_TYPE, lambda message, _: call_in(message))
            readers.append(self._keep_trying(read))
        if config.diagnostics:
            find = partial(
                self._find, config.diagnostics_topic, DIAGNOSTICS_TYPE, USUAL_DIAGNOSTICS
            )
            readers.append(self._keep_trying(partial(self._read_found, find, rules.on_diagnostics)))
        if config.geofence:
            find = partial(self._find, config.pose_topic, ODOMETRY_TYPE, USUAL_ODOMETRY)
            readers.append(
                self._keep_trying(partial(self._read_found, find, partial(self._on_pose, rules)))
            )
        if config.navigation_topic is not None:
            read = partial(self._read_navigation, config.navigation_topic)
            readers.append(self._keep_trying(read, lambda: self._on_navigation(None)))
        if config.stopped or config.battery_below is not None:
            readers.append(self._keep_checking())
        return readers

    def _find(
        self, name: str | None, kind: str, usual: Sequence[str], topics: Mapping[str, str]
    ) -> str | None:
        return name or own_topic(topics, kind, usual, self._graph.drive_topic)

    async def _keep_checking(self) -> NoReturn:
        config, rules = self._config, self._rules
        while True:
            if config.stopped:
                self._ask(rules.on_stopped(*self._stop_state(), _now_s()))
            if config.battery_below is not None:
                self._ask(rules.on_battery(self._battery(), _now_s()))
            await asyncio.sleep(CHECK_EVERY_S)

    async def _keep_trying(
        self, read: Callable[[], Awaitable[None]], on_failure: Callable[[], None] = lambda: None
    ) -> NoReturn:
        while True:
            try:
                await read()
            except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
                # rosbridge is down, or has no rosapi: health reports the former.
                log.debug("cannot read a topic of the rules for help: %r", error)
                on_failure()
            await asyncio.sleep(RETRY_S)

    async def _read(self, topic: str, kind: str, on_message: OnMessage) -> None:
        async with self._subscribed(topic, kind) as rosbridge:
            while True:
                self._ask(on_message(await rosbridge.message(), _now_s()))

    async def _read_found(self, find: FindTopic, on_message: OnMessage) -> None:
        """Read a topic if it is there, until another one is found."""
        topics = await self._graph.topics()
        topic = find(topics)
        if topic in topics:
            await first_of(
                self._read(topic, topics[topic], on_message),
                self._graph.until_another(topic, find),
            )

    async def _read_navigation(self, topic: str) -> None:
        """Notice that the topic is silent, or not there while the graph can be read."""
        kind = (await self._graph.topics()).get(topic)
        if kind is None:
            self._on_navigation(published=False)
            return
        async with self._subscribed(topic, kind) as rosbridge:
            while True:
                self._on_navigation(published=await _is_published(rosbridge))

    @asynccontextmanager
    async def _subscribed(self, topic: str, kind: str) -> AsyncIterator[Rosbridge]:
        async with connected(self._graph.url, max_message_bytes=MAX_MESSAGE_BYTES) as rosbridge:
            await rosbridge.subscribe(topic, kind, throttle_ms=THROTTLE_MS)
            yield rosbridge

    def _on_navigation(self, published: bool | None) -> None:
        self._ask(self._rules.on_navigation(published, _now_s()))

    def _ask(self, call: HelpCall | None) -> None:
        if call is not None:
            log.info("asking for help (%s): %s", call.source, call.reason)
            self._waiting[call.source] = call
            self._has_calls.set()


async def _is_published(rosbridge: Rosbridge) -> bool:
    """Return whether a message comes before the next check is due."""
    try:
        await within(CHECK_EVERY_S, rosbridge.message())
    except asyncio.TimeoutError:
        return False
    return True


def _now_s() -> float:
    return asyncio.get_running_loop().time()
