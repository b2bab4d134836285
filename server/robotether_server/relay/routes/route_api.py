"""Answers GET /api/v1/routes/live: the routes as they are now."""

from __future__ import annotations

import msgspec
from aiohttp import web

from robotether_server.contract.routes import LiveRouteList
from robotether_server.relay.auth.access import Access, request_of
from robotether_server.relay.control.control_api import NO_STORE
from robotether_server.relay.routes.routes import RouteRunner


class RouteApi:
    """Answers what asks for routes over HTTP."""

    def __init__(self, access: Access, routes: RouteRunner) -> None:
        self._access = access
        self._routes = routes

    def add_routes(self, app: web.Application) -> None:
        """Route the path of the contract here."""
        app.router.add_get("/api/v1/routes/live", self.handle, allow_head=False)

    async def handle(self, request: web.Request) -> web.Response:
        """Answer with the routes that the caller may see."""
        access_request = request_of(request.headers, request.cookies, request.query)
        asker = await self._access.for_events(access_request)
        body = msgspec.json.encode(LiveRouteList(self._routes.live(asker.user.id)))
        return web.Response(
            body=body, content_type="application/json", charset="utf-8", headers=NO_STORE
        )
