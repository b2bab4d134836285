"""Answers /api/v1/events: the fleet as server-sent events.

`app` runs one handler a client, which follows the fleet by one `Subscriber`. A client that does not read is
disconnected after a while.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

import msgspec
from aiohttp import web

from robotether_server.problems import TooManyConnectionsError
from robotether_server.relay.auth.access import Access, request_of
from robotether_server.relay.auth.connections import Connections
from robotether_server.relay.auth.credentials import Credentials
from robotether_server.relay.control.fleet_events import Event, FleetEvents, Subscriber

# Interval between comments on a quiet stream. Pages call one dead that is silent for 7 s.
COMMENT_EVERY_S = 3.0
SLOW_AFTER_S = 10.0
# Minimum interval between events: a robot that reports without a pause must not keep all clients' streams busy.
EVENTS_EVERY_S = 0.05
HEADERS = {
    "Content-Type": "text/event-stream; charset=utf-8",
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
}


@dataclass(frozen=True)
class EventsHandler:
    """Answers /api/v1/events."""

    access: Access
    credentials: Credentials
    fleet_events: FleetEvents
    connections: Connections

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Send the fleet, then each change, until the client or its right is gone."""
        asker = await self.access.for_events(request_of(request))
        count = self.fleet_events.subscribers_of(asker.user.id)
        if count >= self.connections.caps.per_user:
            raise TooManyConnectionsError(
                f"cannot follow the fleet: you already follow it {count} times"
            )
        response = web.StreamResponse(headers=HEADERS)
        with (
            self.fleet_events.subscribed(asker.user.id) as subscriber,
            self.credentials.held(asker.credential, subscriber.end),
        ):
            await response.prepare(request)
            try:
                await self._stream(response, subscriber)
            except (TimeoutError, ConnectionError):
                if request.transport is not None:
                    request.transport.abort()
        return response

    async def _stream(self, response: web.StreamResponse, subscriber: Subscriber) -> None:
        await _write(response, render([subscriber.first_event()]))
        while not subscriber.ended:
            await subscriber.wait(COMMENT_EVERY_S)
            events = subscriber.pop_events()
            await _write(response, render(events) if events else b": awake\n\n")
            await asyncio.sleep(EVENTS_EVERY_S)


def render(events: list[Event]) -> bytes:
    """Write events in the format of text/event-stream."""
    return b"".join(
        b"event: %b\ndata: %b\n\n" % (name.encode(), msgspec.json.encode(data))
        for name, data in events
    )


async def _write(response: web.StreamResponse, data: bytes) -> None:
    async with asyncio.timeout(SLOW_AFTER_S):
        await response.write(data)
