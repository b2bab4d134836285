"""Watches the robot's rosbridge and its source of video, and reports changes.

`Health` is run by the agent for its whole life. A service that is down never ends the tunnel: the server is notified,
and the tunnel waits for it. Asks every 2 s: rosbridge by one WebSocket that is held open and pinged (a new one each
time would fill rosbridge's log), web_video_server by its port and, once in a while, by GET /. Without web_video_server,
or if the settings exclude it, video is up when rosbridge has frames of this robot or a camera of the settings answers,
which is checked less often.
"""

from __future__ import annotations

import asyncio
import logging
import random
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from http import HTTPStatus
from pathlib import Path
from urllib.parse import urlsplit

import aiohttp
from robotether_common.session import ServiceState

from robotether_agent.describe_error import describe_error
from robotether_agent.exposure import PAST_GUARD, exposed_at, port_of, rosbridge_advice
from robotether_agent.problems import AgentError, RosbridgeDownError, VideoSourceDownError
from robotether_agent.rosbridge import RosGraph
from robotether_agent.rosbridge_socket import (
    CONNECT_WITHIN_S,
    RosbridgeSocket,
    new_http,
    open_rosbridge,
)
from robotether_agent.tasks import first_of, within
from robotether_agent.video.sources import SourceSettings, cameras_by_rosbridge

PROBE_EVERY_S = 2.0
TIMEOUT_S = 2.0
# Number of checks between two looks at rosapi, cameras and the kernel's listening sockets.
SELDOM = 15
SPREAD = 0.5, 1.5

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class HealthReport:
    """How both services are, and for each that is down, why."""

    ros: ServiceState = "unknown"
    video: ServiceState = "unknown"
    ros_detail: str = ""
    video_detail: str = ""
    # The address at which everybody in the robot's own network reaches rosbridge, past the guard, and what ends that.
    ros_exposed: str = ""
    ros_exposed_advice: str = ""

    @property
    def detail(self) -> str:
        """One text for the server."""
        return "; ".join(text for text in (self.ros_detail, self.video_detail) if text)


class Health:
    """The two probes and what they found last."""

    def __init__(
        self,
        source_settings: SourceSettings,
        graph: RosGraph,
        *,
        every_s: float = PROBE_EVERY_S,
    ) -> None:
        self.report = HealthReport()
        self._source_settings = source_settings
        self._graph = graph
        self._rosbridge_url = source_settings.rosbridge_url
        self._video_url = source_settings.video_url
        self._every_s = every_s
        self._rng = random.SystemRandom()
        self._condition = asyncio.Condition()
        self._is_rosbridge_up = False
        # Whether there are frames elsewhere than at video_url; until when that counts, and with which rosbridge.
        self._elsewhere = self._elsewhere_was_up = False
        self._elsewhere_until_s = 0.0
        # Until when an answer of web_video_server counts while its port stays open.
        self._server_asked_until_s = 0.0

    async def run(self) -> None:
        """Probe both without end."""
        async with new_http() as http:
            await first_of(
                self._again(lambda: self._hold_rosbridge(http), self._ros_is),
                self._again(lambda: self._ask_video(http), self._video_is),
                self._watch_exposure(),
            )

    async def changed(self, report: HealthReport) -> HealthReport:
        """Return the report as soon as it is another one than `report`."""
        async with self._condition:
            await self._condition.wait_for(lambda: self.report != report)
            return self.report

    async def _again(
        self,
        probe: Callable[[], Awaitable[None]],
        on_result: Callable[[AgentError | None], Awaitable[None]],
    ) -> None:
        while True:
            try:
                await probe()
            except AgentError as problem:
                await on_result(problem)
            await asyncio.sleep(self._every_s)

    async def _watch_exposure(self) -> None:
        while True:
            # To list its sockets takes the kernel milliseconds, more on a machine with more memory. So nothing waits
            # for it, and robots that share a machine ask at different moments.
            address = await asyncio.to_thread(exposed_at, self._rosbridge_url)
            if address is not None and address != self.report.ros_exposed:
                advice = await rosbridge_advice(self._rosbridge_url) if address else ""
                report = replace(self.report, ros_exposed=address, ros_exposed_advice=advice)
                await self._set(report)
                if address:
                    log.warning("rosbridge answers at %s: %s; %s", address, PAST_GUARD, advice)
            await asyncio.sleep(SELDOM * self._every_s * self._rng.uniform(*SPREAD))

    async def _hold_rosbridge(self, http: aiohttp.ClientSession) -> None:
        """Hold one WebSocket as long as rosbridge answers its pings; one that it closes at once is no answer."""
        try:
            socket = await open_rosbridge(http, self._rosbridge_url, heartbeat_s=self._every_s)
        except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
            raise self._rosbridge_down(describe_error(error, CONNECT_WITHIN_S)) from error
        async with socket:
            with suppress(asyncio.TimeoutError):
                await socket.receive(self._every_s / 4)
            if not socket.closed:
                await self._hold(socket)
            cause = socket.exception()
        # aiohttp gives a pong half of the heartbeat's time.
        raise self._rosbridge_down(
            describe_error(cause, self._every_s / 2) if cause else "it closed the connection"
        )

    async def _hold(self, socket: RosbridgeSocket) -> None:
        await self._ros_is(None)
        self._is_rosbridge_up = True
        try:
            async for _ in socket:
                pass
        finally:
            self._is_rosbridge_up = False

    async def _ask_video(self, http: aiohttp.ClientSession) -> None:
        """Raise VideoSourceDownError unless there is somewhere where frames come from."""
        try:
            if self._source_settings.source == "rosbridge":
                raise self._no_images("rosbridge has no images of this robot that can be shown")
            await self._ask_server(http)
        except VideoSourceDownError:
            if not await self._is_elsewhere():
                raise
        await self._video_is(None)

    async def _is_elsewhere(self) -> bool:
        """Whether rosbridge or a camera of the settings has frames; asks once in a while."""
        now_s, is_up = asyncio.get_running_loop().time(), self._is_rosbridge_up
        if now_s >= self._elsewhere_until_s or is_up != self._elsewhere_was_up:
            self._elsewhere = await self._has_images() or await self._has_camera()
            self._elsewhere_until_s = now_s + SELDOM * self._every_s
            self._elsewhere_was_up = is_up
        return self._elsewhere

    async def _has_images(self) -> bool:
        if self._source_settings.source == "web_video_server" or not self._is_rosbridge_up:
            return False
        try:
            return bool(cameras_by_rosbridge(await self._graph.own_topics()))
        except (aiohttp.ClientError, OSError, asyncio.TimeoutError):
            # No rosapi: whoever chose rosbridge knows that it has frames.
            return self._source_settings.source == "rosbridge"

    async def _has_camera(self) -> bool:
        for url in self._source_settings.cameras.values():
            if await _is_there(url):
                return True
        return False

    async def _ask_server(self, http: aiohttp.ClientSession) -> None:
        """Ask by HTTP once in a while, which is a line in ROS's log, and in between only whether the port is open."""
        now_s = asyncio.get_running_loop().time()
        if now_s < self._server_asked_until_s and await _is_open(self._video_url):
            return
        self._server_asked_until_s = 0.0
        await self._request_page(http)
        self._server_asked_until_s = now_s + SELDOM * self._every_s

    async def _request_page(self, http: aiohttp.ClientSession) -> None:
        try:
            timeout = aiohttp.ClientTimeout(total=TIMEOUT_S)
            async with http.get(
                self._video_url, timeout=timeout, allow_redirects=False
            ) as response:
                status = response.status
        except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
            raise self._video_down(describe_error(error, TIMEOUT_S)) from error
        if status >= HTTPStatus.INTERNAL_SERVER_ERROR:
            raise self._video_down(f"HTTP status {status}")

    def _rosbridge_down(self, reason: str) -> AgentError:
        return RosbridgeDownError(f"rosbridge at {self._rosbridge_url} does not answer: {reason}")

    def _video_down(self, reason: str) -> AgentError:
        return VideoSourceDownError(
            f"web_video_server at {self._video_url} does not answer: {reason}"
        )

    def _no_images(self, reason: str) -> AgentError:
        if not self._is_rosbridge_up:
            reason = "rosbridge, the source of its video, does not answer"
        return VideoSourceDownError(f"there is no video: {reason}")

    async def _ros_is(self, problem: AgentError | None) -> None:
        state, detail = _state_of(problem)
        if state != self.report.ros:
            _log_change(f"rosbridge at {self._rosbridge_url} answers", problem)
        await self._set(replace(self.report, ros=state, ros_detail=detail))

    async def _video_is(self, problem: AgentError | None) -> None:
        state, detail = _state_of(problem)
        if state != self.report.video:
            _log_change("there is video", problem)
        await self._set(replace(self.report, video=state, video_detail=detail))

    async def _set(self, report: HealthReport) -> None:
        async with self._condition:
            self.report = report
            self._condition.notify_all()


async def _is_there(camera_url: str) -> bool:
    """Return whether a camera's device exists, or somebody accepts connections at its URL's port."""
    if camera_url.startswith("/"):
        return await asyncio.to_thread(Path(camera_url).exists)
    return await _is_open(camera_url)


async def _is_open(url: str) -> bool:
    """Return whether somebody accepts connections at the URL's port."""
    with suppress(OSError, asyncio.TimeoutError):
        opening = asyncio.open_connection(urlsplit(url).hostname, port_of(url))
        _, writer = await within(TIMEOUT_S, opening)
        writer.close()
        return True
    return False


def _state_of(problem: AgentError | None) -> tuple[ServiceState, str]:
    return ("ok", "") if problem is None else ("down", problem.message)


def _log_change(good: str, problem: AgentError | None) -> None:
    if problem is None:
        log.info("%s", good)
    else:
        log.warning("%s; the tunnel stays open and waits for it", problem)
