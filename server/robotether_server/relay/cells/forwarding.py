"""Decides which requests the relay of another cell answers: those for a robot that it has.

`app` asks before any handler. nginx passes the request on as it came, to the other cell's nginx, whose relay checks it.
So forwarded data never passes this relay, except observers' topics, of which only one copy crosses the line between the
cells. Strangers are refused here: a forward may cost both cells a TLS handshake.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from aiohttp import web

from robotether_server.db.fleet import Snapshot
from robotether_server.relay.auth.access import Access, request_of
from robotether_server.relay.cells.forwarded_observers import ForwardedObservers
from robotether_server.relay.cells.peers import Peers

FORWARDED = re.compile(
    r"/robots/(?P<robot>[^/]+)/(?P<path>.+)|/api/v1/robots/(?P<controlled>[^/]+)/"
    r"(?P<action>stop|release|lease|control|uplink|(topics|services)/.+)"
)
# The named locations of images/nginx/peer-forward.conf. When the other cell does not answer, a stop begins here.
LOCATION, STOP_LOCATION = "@cell", "@cell_or_here"
CELL_HEADER = "X-Robotether-Cell"


@dataclass(frozen=True)
class Forwarding:
    """Sends nginx to the cell that has the robot."""

    peers: Peers
    snapshot: Callable[[], Snapshot]
    access: Access
    observers: ForwardedObservers

    async def answer(self, request: web.Request) -> web.StreamResponse | None:
        """Serve an observer, or return what has nginx forward the request; None: it is answered here."""
        match = FORWARDED.fullmatch(request.path)
        if match is None or not self.peers.count():
            return None
        stops = match["action"] == "stop"
        access_request = request_of(request, stops=stops)
        mac = access_request.mac if stops else None
        robot = self.snapshot().meant(match["robot"] or match["controlled"], mac)
        peer = None if robot is None else self.peers.owner(robot.id)
        if robot is None or peer is None:
            return None
        ticket = self.access.observer_ticket(access_request) if match["path"] == "ros" else None
        if ticket is not None and web.WebSocketResponse().can_prepare(request):
            served = await self.observers.join(request, ticket, robot, peer)
            if served is not None:
                return served
        if not await self.access.is_vouched_for(access_request):
            return None
        location = STOP_LOCATION if stops else LOCATION
        # No content: nginx would take its type for that of the forwarded answer.
        return web.Response(
            status=204, headers={"X-Accel-Redirect": location, CELL_HEADER: peer.address}
        )
