"""Answers which routes last as they are now, and the caller's web apps: those of this cell and of all that answer it.

Each cell knows the routes whose target it has, and its own apps. A cell that does not answer in time is left out: its
routes stay `elsewhere`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import msgspec
from aiohttp import ClientError, web

from robotether_server.contract.routes import LiveRoute, LiveRouteList
from robotether_server.problems import HttpError
from robotether_server.relay.auth.access import Access, request_of
from robotether_server.relay.cells.cell_client import CellClient
from robotether_server.relay.cells.peers import Peer, Peers
from robotether_server.relay.control.control_api import answer_json

PATH = "/api/v1/routes/live"
CELL_PATH = "/cell/v1/routes"
# Time limit for the other cells: people wait for the answer, and pages ask again and again.
ANSWER_WITHIN_S = 1.0
_DECODER = msgspec.json.Decoder(LiveRouteList)


@dataclass(frozen=True)
class LiveRoutes:
    """`list_own` gives what this cell knows, for a user by id. Without `cells` there are no others."""

    access: Access
    list_own: Callable[[int], LiveRouteList]
    peers: Peers
    cells: CellClient | None

    async def show(self, request: web.Request) -> web.Response:
        """Answer with the routes that the caller may see, and the caller's apps."""
        asker = await self.access.for_events(request_of(request))
        own, others = self.list_own(asker.user.id), await self._ask_others(asker.user.id)
        routes = [_newest(route, others) for route in own.routes]
        return answer_json(
            LiveRouteList(routes, [app for each in (own, *others) for app in each.apps])
        )

    async def show_own(self, request: web.Request) -> web.Response:
        """Answer another cell with what this one knows, for the user whose number it names."""
        try:
            user_id = int(request.query.get("user_id", ""))
        except ValueError as exc:
            raise HttpError(400, "cannot list routes: `user_id` must be a number") from exc
        return answer_json(self.list_own(user_id))

    async def _ask_others(self, user_id: int) -> list[LiveRouteList]:
        if self.cells is None:
            return []
        questions = (self._ask(self.cells, peer, user_id) for peer in self.peers.all())
        return [answer for answer in await asyncio.gather(*questions) if answer is not None]

    async def _ask(self, cells: CellClient, peer: Peer, user_id: int) -> LiveRouteList | None:
        try:
            async with asyncio.timeout(ANSWER_WITHIN_S):
                answer = await cells.read(peer, f"{CELL_PATH}?user_id={user_id}")
            live_routes = _DECODER.decode(answer)
        # A relay of an older version answers 404.
        except (ClientError, OSError, ValueError):
            return None
        apps = [msgspec.structs.replace(app, machine=peer.name) for app in live_routes.apps]
        return LiveRouteList(live_routes.routes, apps)


def _newest(route: LiveRoute, others: Iterable[LiveRouteList]) -> LiveRoute:
    """Return what is known of a route: a cell that runs it knows best, then this one, then why it waits at another."""
    candidates = [
        route,
        *(each for other in others for each in other.routes if each.id == route.id),
    ]
    return min(candidates, key=lambda each: ("runs", "waits", "elsewhere").index(each.state))
