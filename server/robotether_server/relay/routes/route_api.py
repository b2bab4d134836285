"""Answers GET /api/v1/routes/live: the routes as they are now."""

from __future__ import annotations

import msgspec
from aiohttp import web

from robotether_server.contract.routes import LiveRouteList
from robotether_server.relay.auth.access import Access, request_of
from robotether_server.relay.control.control_api import NO_STORE
from robotether_server.relay.routes.apps import Apps
from robotether_server.relay.routes.routes import RouteRunner


class RouteApi:
    """Answers what asks for routes over HTTP."""

    def __init__(self, access: Access, routes: RouteRunner, apps: Apps) -> None:
        self._access = access
        self._routes = routes
        self._apps = apps

    def add_routes(self, app: web.Application) -> None:
        """Route the path of the contract here."""
        app.router.add_get("/api/v1/routes/live", self.handle, allow_head=False)

    async def handle(self, request: web.Request) -> web.Response:
        """Answer with the routes that the caller may see, and the caller's apps."""
        asker = await self._access.for_events(request_of(request))
        user_id = asker.user.id
        apps = [app.describe() for app in self._apps.of_user(user_id)]
        body = msgspec.json.encode(LiveRouteList(self._routes.live(user_id), apps))
        return web.Response(
            body=body, content_type="application/json", charset="utf-8", headers=NO_STORE
        )
