"""The fleet as server-sent events, for pages that show who is online.

`app` runs one handler a client. A client that does not read is let go after a while; until then it
costs one set of robot ids, because its `Subscriber` keeps no history.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable

from aiohttp import web

from robotether_server.problems import TooManyConnections
from robotether_server.relay.auth.access import Access, request_of
from robotether_server.relay.auth.credentials import Credentials
from robotether_server.relay.events.fleet_events import Event, FleetEvents, Subscriber

COMMENT_EVERY_S = 10.0
SLOW_AFTER_S = 10.0
HEADERS = {
    "Content-Type": "text/event-stream; charset=utf-8",
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
}


class EventsHandler:
    """Answers /api/v1/events."""

    def __init__(
        self,
        access: Access,
        credentials: Credentials,
        fleet_events: FleetEvents,
        max_per_user: Callable[[], int],
    ) -> None:
        self._access = access
        self._credentials = credentials
        self._fleet_events = fleet_events
        self._max_per_user = max_per_user

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Tell the fleet, then each change, until the client or its right is gone."""
        asked = request_of(request.headers, request.cookies, request.query)
        asker = await self._access.for_events(asked)
        mine = self._fleet_events.subscribers_of(asker.user.id)
        if mine >= self._max_per_user():
            raise TooManyConnections(f"cannot follow the fleet: you already follow it {mine} times")
        response = web.StreamResponse(headers=HEADERS)
        with (
            self._fleet_events.subscribed(asker.user.id) as subscriber,
            self._credentials.held(asker.credential, subscriber.end),
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


def render(events: list[Event]) -> bytes:
    """Write events in the format of text/event-stream."""
    return b"".join(
        f"event: {name}\ndata: {json.dumps(data, separators=(',', ':'))}\n\n".encode()
        for name, data in events
    )


async def _write(response: web.StreamResponse, data: bytes) -> None:
    async with asyncio.timeout(SLOW_AFTER_S):
        await response.write(data)
