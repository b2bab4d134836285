"""What the handlers of rosbridge and of video need alike to let somebody through to a robot. Made by `relay`."""

from __future__ import annotations

from dataclasses import dataclass

from aiohttp import ClientSession

from robotether_server.relay.auth.access import Access
from robotether_server.relay.auth.connections import Connections
from robotether_server.relay.auth.credentials import Credentials
from robotether_server.relay.robots.sessions import SessionRegistry


@dataclass(frozen=True)
class HandlerContext:
    """Who may, who is there, and the way to the tunnels: robots' ports listen at `tunnel_host`."""

    access: Access
    credentials: Credentials
    registry: SessionRegistry
    connections: Connections
    client: ClientSession
    tunnel_host: str
