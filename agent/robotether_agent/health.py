"""Watches rosbridge and web_video_server on the robot, and tells when that changes.

Run by the agent for its whole life. A service that is down never ends the tunnel: the server is told,
and the tunnel waits for it. Asks every 2 s: rosbridge by one WebSocket that is held open and pinged (a new
one each time would fill rosbridge's log), web_video_server by GET /.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from http import HTTPStatus
from typing import Literal

import aiohttp

from robotether_agent.problems import Problem, RosbridgeDown, VideoDown
from robotether_agent.reasons import why
from robotether_agent.tasks import first_of, within

ServiceState = Literal["ok", "down", "unknown"]
PROBE_EVERY_S = 2.0
TIMEOUT_S = 2.0
MESSAGE_LIMIT = 64 * 1024

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class HealthReport:
    """How both services are, and for each that is down, why."""

    ros: ServiceState = "unknown"
    video: ServiceState = "unknown"
    ros_detail: str = ""
    video_detail: str = ""

    @property
    def detail(self) -> str:
        """One text for the server."""
        return "; ".join(text for text in (self.ros_detail, self.video_detail) if text)


class Health:
    """The two probes and what they found last."""

    def __init__(
        self, rosbridge_url: str, video_url: str, *, every_s: float = PROBE_EVERY_S
    ) -> None:
        self.report = HealthReport()
        self._rosbridge_url = rosbridge_url
        self._video_url = video_url
        self._every_s = every_s
        self._news = asyncio.Condition()

    async def run(self) -> None:
        """Probe both without end."""
        async with aiohttp.ClientSession() as http:
            await first_of(
                self._again(lambda: self._hold_rosbridge(http), self._ros_is),
                self._again(lambda: self._ask_video(http), self._video_is),
            )

    async def changed(self, known: HealthReport) -> HealthReport:
        """Return the report as soon as it is another one than `known`."""
        async with self._news:
            await self._news.wait_for(lambda: self.report != known)
            return self.report

    async def _again(
        self,
        probe: Callable[[], Awaitable[None]],
        tell: Callable[[Problem | None], Awaitable[None]],
    ) -> None:
        while True:
            try:
                await probe()
            except Problem as problem:
                await tell(problem)
            await asyncio.sleep(self._every_s)

    async def _hold_rosbridge(self, http: aiohttp.ClientSession) -> None:
        """Hold one WebSocket as long as rosbridge answers its pings."""
        try:
            socket = await within(TIMEOUT_S, self._connect_rosbridge(http))
        except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
            raise self._rosbridge_down(why(error, TIMEOUT_S)) from error
        async with socket:
            await self._ros_is(None)
            async for _ in socket:
                pass
            cause = socket.exception()
        raise self._rosbridge_down(why(cause, TIMEOUT_S) if cause else "it closed the connection")

    async def _connect_rosbridge(
        self, http: aiohttp.ClientSession
    ) -> aiohttp.ClientWebSocketResponse:
        return await http.ws_connect(
            self._rosbridge_url, heartbeat=self._every_s, max_msg_size=MESSAGE_LIMIT
        )

    async def _ask_video(self, http: aiohttp.ClientSession) -> None:
        try:
            async with http.get(
                self._video_url, timeout=aiohttp.ClientTimeout(total=TIMEOUT_S)
            ) as response:
                status = response.status
        except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
            raise self._video_down(why(error, TIMEOUT_S)) from error
        if status >= HTTPStatus.INTERNAL_SERVER_ERROR:
            raise self._video_down(f"HTTP status {status}")
        await self._video_is(None)

    def _rosbridge_down(self, reason: str) -> Problem:
        return RosbridgeDown(f"rosbridge at {self._rosbridge_url} does not answer: {reason}")

    def _video_down(self, reason: str) -> Problem:
        return VideoDown(f"web_video_server at {self._video_url} does not answer: {reason}")

    async def _ros_is(self, problem: Problem | None) -> None:
        state, detail = _told(problem)
        if state != self.report.ros:
            _log_change("rosbridge", self._rosbridge_url, problem)
        await self._set(replace(self.report, ros=state, ros_detail=detail))

    async def _video_is(self, problem: Problem | None) -> None:
        state, detail = _told(problem)
        if state != self.report.video:
            _log_change("web_video_server", self._video_url, problem)
        await self._set(replace(self.report, video=state, video_detail=detail))

    async def _set(self, report: HealthReport) -> None:
        async with self._news:
            self.report = report
            self._news.notify_all()


def _told(problem: Problem | None) -> tuple[ServiceState, str]:
    return ("ok", "") if problem is None else ("down", problem.message)


def _log_change(service: str, url: str, problem: Problem | None) -> None:
    if problem is None:
        log.info("%s at %s answers", service, url)
    else:
        log.warning("%s; the tunnel stays open and waits for it", problem)
