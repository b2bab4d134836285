"""A connection beside the session, open while the server requests what it forwards.

The daemon has one row for each. The services that they forward are rows of robotether_common.services.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from aiohttp import web
from robotether_common.line_rate import BYTES_PER_S
from robotether_common.line_rate import PATH as LINE_PATH
from robotether_common.services import BY_CONNECTION, ServiceName
from robotether_common.session import ByeCode, Kind
from robotether_common.topics import PATH as TOPICS_PATH

from robotether_agent.backoff import Uptime
from robotether_agent.net.server_dialer import SshAddress
from robotether_agent.problems import AgentError, SessionEndedError
from robotether_agent.rosbridge import RosGraph
from robotether_agent.settings import Settings
from robotether_agent.status import StatusWriter
from robotether_agent.topics_service import TopicsService
from robotether_agent.tunnel.connection import Role
from robotether_agent.tunnel.openssh import ServiceAddress, target_of
from robotether_agent.tunnel.session import FeatureRequest, Session, SessionConfig
from robotether_agent.video.frames_service import FramesService
from robotether_agent.video.pacer import Pacer
from robotether_agent.video.receiver import OnFrameSent
from robotether_agent.video.sources import SourceSettings
from robotether_agent.video.video_proxy import LocalService, VideoProxy

LOCALHOST = "127.0.0.1"
# Whether the agent answers what is else web_video_server's, by the setting video_source.
OWN_ANSWERS: dict[str, Literal["never", "down", "always"]] = {
    "auto": "down",
    "web_video_server": "never",
    "rosbridge": "always",
}

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class RequestedConnection:
    """Keeps a connection while the server requests it; `serve` runs what one connection's role leads to."""

    kind: Kind
    request: FeatureRequest
    serve: Callable[[], AbstractAsyncContextManager[Role]]
    # The server's code when it requests the connection no more, the log's words for it, and the status from then on.
    bye: ByeCode
    reason: str
    idle: str
    connect: Callable[[Role], Awaitable[None]]
    status_writer: StatusWriter
    session_up: asyncio.Event
    # Set when the forward is up.
    recheck: asyncio.Event

    @property
    def service(self) -> ServiceName:
        """The service that it forwards."""
        return BY_CONNECTION[self.kind].name

    async def attempt(self, uptime: Uptime) -> None:
        """Wait for a request, and stay connected until the server or a problem ends it."""
        # A robot that comes back may have no request any more.
        while not (self.request.is_set() and self.session_up.is_set()):
            await self.request.wait()
            await self.session_up.wait()
        number = self.request.number
        try:
            async with self.serve() as role:
                await self.connect(replace(role, on_up=partial(self._is_up, uptime)))
        except SessionEndedError as problem:
            if problem.code != self.bye:
                raise
            # The session may have brought another request while this connection ended.
            self.request.end(number)
            self.status_writer.set(**self.status(is_open=False))
            log.info("robot %s: %s", self.status_writer.status.robot, self.reason)

    def on_problem(self, problem: AgentError) -> None:
        """Show the problem that ended the connection."""
        state = self.status_writer.status.state
        self.status_writer.report_problem(problem, state, **self.status(is_open=False))

    def status(self, *, is_open: bool | None = None) -> dict[str, str]:
        """Return what the status says of the connection; `is_open` None leaves that as it is."""
        member = f"{self.service}_tunnel"
        if not self.request.is_set():
            return {member: self.idle}
        if is_open is None:
            is_open = getattr(self.status_writer.status, member) == "open"
        return {member: "open" if is_open else "closed"}

    def _is_up(self, uptime: Uptime, _: SshAddress, config: SessionConfig, __: Session) -> None:
        uptime.is_up()
        if config.ports[self.service] is not None:
            self.recheck.set()
            was_open = self.status() == self.status(is_open=True)
            self.status_writer.set(**self.status(is_open=True))
            if not was_open:
                log.info("robot %s: %s tunnel open", config.robot, self.service)


@asynccontextmanager
async def serve_video(
    settings: Settings,
    source_settings: SourceSettings,
    graph: RosGraph,
    has_video: Callable[[], bool],
    *,
    on_frame_sent: OnFrameSent,
    on_encoders: Callable[[str], None],
) -> AsyncIterator[Role]:
    """Serve the robot's cameras and topics by a video proxy."""
    topics, pacer = TopicsService(settings.rosbridge_url), Pacer()

    async def answer_line_rate(_request: web.Request) -> web.Response:
        return web.json_response({BYTES_PER_S: pacer.line_rate()})

    frames = FramesService(
        source_settings,
        graph,
        video_encoder=settings.video_encoder,
        has_video=has_video,
        routes={TOPICS_PATH: topics.answer, LINE_PATH: answer_line_rate},
        on_frame_sent=on_frame_sent,
        on_encoders=on_encoders,
        line_rate=pacer.line_rate,
    )
    async with AsyncExitStack() as ends:
        ends.push_async_callback(topics.close)
        ends.push_async_callback(frames.close)
        local = LocalService(
            await frames.start(), OWN_ANSWERS[settings.video_source], frames.yields
        )
        video_proxy = VideoProxy(settings.video_url, local, pacer)
        ends.push_async_callback(video_proxy.close)
        target = ServiceAddress(LOCALHOST, await video_proxy.start())
        yield Role(kind="media", target=lambda: target, video_proxy=video_proxy)


@asynccontextmanager
async def serve_shell(settings: Settings) -> AsyncIterator[Role]:
    """Lead to the robot's own SSH server."""
    target = target_of(f"ssh://{settings.shell_address}")
    yield Role(kind="shell", target=lambda: target)
