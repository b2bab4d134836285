"""All kinds of channels, and the paths that they answer."""

from __future__ import annotations

from collections.abc import Callable

from aiohttp import web

from robotether_server.relay.channels.events import EventsHandler
from robotether_server.relay.channels.rosbridge.handler import (
    BridgeRules,
    ConnectionReport,
    RosbridgeHandler,
    SessionContext,
)
from robotether_server.relay.channels.rosbridge.http_calls import HttpCalls
from robotether_server.relay.channels.rosbridge.service_api import ServiceApi
from robotether_server.relay.channels.rosbridge.topic_api import TopicApi
from robotether_server.relay.channels.video.frames_handler import FramesHandler
from robotether_server.relay.channels.video.handler import VideoHandler
from robotether_server.relay.channels.video.viewers import VideoContext
from robotether_server.relay.control.control import Control
from robotether_server.relay.control.fleet_events import FleetEvents


def channel_routes(
    context: VideoContext,
    control: Control,
    fleet_events: FleetEvents,
    *,
    rules: BridgeRules,
    report: Callable[[ConnectionReport], None],
) -> list[web.RouteDef]:
    """Return the paths of the contract, each with a handler of its kind."""
    rosbridge = RosbridgeHandler(SessionContext(context, control, rules, report))
    calls = HttpCalls(context, rules.traffic)
    topics, services = TopicApi(calls, rules.shared_topics), ServiceApi(calls, control)
    frames, video = FramesHandler(context, rules.limits), VideoHandler(context)
    events = EventsHandler(context.access, context.credentials, fleet_events, context.connections)
    return [
        web.get("/robots/{name}/ros", rosbridge.handle, allow_head=False),
        web.get("/robots/{name}/video/frames", frames.handle, allow_head=False),
        web.route("*", "/robots/{name}/video", video.handle),
        web.route("*", "/robots/{name}/video/{path:.*}", video.handle),
        web.get("/api/v1/robots/{name}/topics/{topic:.+}", topics.handle, allow_head=False),
        web.post("/api/v1/robots/{name}/services/{service:.+}", services.handle),
        web.get("/api/v1/events", events.handle, allow_head=False),
    ]
