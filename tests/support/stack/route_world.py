"""Routes of a running relay, as their maker eve and the robots at both ends see them."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fake_robot import WAIT_S, FakeRobot
from relay_server import EVE, MemoryDatabase, RelayServer
from robotether_server.db.routes import RelayRoute, RouteEnd
from site_cells import SiteCell

SOURCE, TARGET = 8, 7
TWIST = "geometry_msgs/msg/Twist"
FOLLOW = RelayRoute(SOURCE, "/cmd_vel", TARGET, "/cmd_vel", TWIST, 50, 5, id=1, user_name="eve")


@dataclass
class RouteWorld:
    """A relay with the target of routes, and with their source unless that is an app."""

    relay: RelayServer
    database: MemoryDatabase
    target: FakeRobot
    source: FakeRobot | None = None

    def live(self, cell: SiteCell | None = None) -> dict[int | None, tuple[str, str]]:
        routes = (cell or self.relay).relay.routes.live(EVE.id).routes
        return {route.id: (route.state, route.why) for route in routes}

    def why(self) -> str:
        return next((why for _, why in self.live().values()), "")

    def ends(self) -> list[str]:
        return [each.code for each in self.database.written if isinstance(each, RouteEnd)]

    def driver(self) -> str | None:
        driver = self.relay.relay.control.describe(TARGET).driver
        return None if driver is None else driver.user

    def published(self) -> list[dict[str, Any]]:
        received = map(json.loads, self.target.received)
        return [message for message in received if message["op"] == "publish"]

    async def send(self, speed: float = 0.5) -> None:
        assert self.source is not None
        message = {"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": speed}}}
        await self.source.send_to_topics(json.dumps(message).encode())

    async def send_until(self, condition: Callable[[], object], speed: float = 0.5) -> None:
        async with asyncio.timeout(WAIT_S):
            while not condition():
                await self.send(speed)
                await asyncio.sleep(0.02)
