"""All kinds of channels, and the paths that they answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from aiohttp import web

from robotether_server.relay.channels.events import EventsHandler, FleetEvents
from robotether_server.relay.channels.rosbridge.handler import (
    BridgeRules,
    ConnectionReport,
    RosbridgeHandler,
)
from robotether_server.relay.channels.rosbridge.http_calls import HttpCalls
from robotether_server.relay.channels.rosbridge.service_api import ServiceApi
from robotether_server.relay.channels.rosbridge.topic_api import TopicApi
from robotether_server.relay.channels.video.frames_handler import FramesHandler
from robotether_server.relay.channels.video.handler import VideoHandler
from robotether_server.relay.channels.video.viewers import VideoContext
from robotether_server.relay.control.control import Control


@dataclass(frozen=True)
class Channels:
    """The handler of each kind."""

    rosbridge: RosbridgeHandler
    frames: FramesHandler
    video: VideoHandler
    events: EventsHandler
    topics: TopicApi
    services: ServiceApi

    def add_routes(self, app: web.Application) -> None:
        """Route the paths of the contract here."""
        router = app.router
        router.add_get("/robots/{name}/ros", self.rosbridge.handle, allow_head=False)
        router.add_get("/robots/{name}/video/frames", self.frames.handle, allow_head=False)
        router.add_route("*", "/robots/{name}/video", self.video.handle)
        router.add_route("*", "/robots/{name}/video/{path:.*}", self.video.handle)
        topics = "/api/v1/robots/{name}/topics/{topic:.+}"
        router.add_get(topics, self.topics.handle, allow_head=False)
        router.add_post("/api/v1/robots/{name}/services/{service:.+}", self.services.handle)
        router.add_get("/api/v1/events", self.events.handle, allow_head=False)


def make_channels(
    context: VideoContext,
    control: Control,
    fleet_events: FleetEvents,
    *,
    rules: BridgeRules,
    report: Callable[[ConnectionReport], None],
) -> Channels:
    """Make a handler of each kind."""
    calls = HttpCalls(context, rules.traffic)
    dialer = context.dialer(rules.message_limit)
    return Channels(
        RosbridgeHandler(context, control, rules=rules, report=report),
        FramesHandler(context, rules.limits),
        VideoHandler(context),
        EventsHandler(context.access, context.credentials, fleet_events, context.connections),
        TopicApi(calls, rules.shared_topics, dialer),
        ServiceApi(calls, control, dialer, rules.message_limit),
    )
