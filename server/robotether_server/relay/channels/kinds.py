"""All kinds of channels, and the paths that they answer."""

from __future__ import annotations

from aiohttp import web

from robotether_server.relay.channels.events import EventsHandler
from robotether_server.relay.channels.rosbridge.handler import (
    RosbridgeHandler,
    SessionContext,
)
from robotether_server.relay.channels.rosbridge.http_calls import HttpCalls
from robotether_server.relay.channels.rosbridge.service_api import ServiceApi
from robotether_server.relay.channels.rosbridge.topic_api import TopicApi
from robotether_server.relay.channels.video.frames_handler import FramesHandler
from robotether_server.relay.channels.video.handler import VideoHandler
from robotether_server.relay.channels.video.viewers import VideoContext
from robotether_server.relay.control.fleet_events import FleetEvents


def channel_routes(
    context: VideoContext, session_context: SessionContext, fleet_events: FleetEvents
) -> list[web.RouteDef]:
    """Return the paths of the contract, each with a handler of its kind."""
    rules, control = session_context.rules, session_context.control
    calls = HttpCalls(context, rules.traffic)
    topics, services = TopicApi(calls, rules.shared_topics), ServiceApi(calls, control)
    frames, video = FramesHandler(context, rules.limits), VideoHandler(context)
    events = EventsHandler(context.access, context.credentials, fleet_events, context.connections)
    return [
        web.get("/robots/{name}/ros", RosbridgeHandler(session_context).handle, allow_head=False),
        web.get("/robots/{name}/video/frames", frames.handle, allow_head=False),
        web.get("/robots/{name}/video", video.handle),
        web.get("/robots/{name}/video/{path:.*}", video.handle),
        web.get("/api/v1/robots/{name}/topics/{topic:.+}", topics.handle, allow_head=False),
        web.post("/api/v1/robots/{name}/services/{service:.+}", services.handle),
        web.get("/api/v1/events", events.handle, allow_head=False),
    ]
