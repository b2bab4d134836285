"""Runs the routes whose target is here, a robot or an app, and ends those that must end. Their table is web's.

`fleet` hands it the routes that last, once a second with robots and rights. A route ends for good when its maker's
right does, its time is over, or its target is stopped or driven by anybody else: it never takes the lease back by
itself. It only waits while a robot or an app is away or the way to one is broken. All routes of a user into a robot
drive it together, with one lease.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta

from robotether_server.contract.routes import LiveRoute, LiveRouteList
from robotether_server.db.fleet import RelayRobot, Snapshot
from robotether_server.db.routes import RelayRoute, RouteEnd
from robotether_server.problems import RobotetherError
from robotether_server.relay.channels.rosbridge.handler import OperatorSession, SessionContext
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.records.event_writer import EventWriter
from robotether_server.relay.robots.connection import Connection
from robotether_server.relay.robots.robot import Change
from robotether_server.relay.routes.apps import App, Apps
from robotether_server.relay.routes.cell_sources import CellSources, ReadableSource
from robotether_server.relay.routes.driver import RouteDriver
from robotether_server.relay.routes.source import RouteSource
from robotether_server.schemas import APP
from robotether_server.times import utc_now

log = logging.getLogger(__name__)

CHECK_EVERY_S = 0.5
# Time after which a connection that failed is tried again.
RETRY_AFTER_S = 2.0
# Maximum difference of the database's clock from this one.
CLOCKS_DIFFER = timedelta(seconds=2)
CONNECTING = "it connects to the target"
# Ends of a drive that end its routes for good; after others they go on once they can.
LASTING_ENDS = frozenset(("robot_stopped", "lease_held", "lease_lost"))


@dataclass(eq=False)
class RunningRoutes:
    """The routes of one user into one robot, with their connection to it, if there is one."""

    robot: RelayRobot
    sources: dict[int, RouteSource] = field(default_factory=dict)
    driver: RouteDriver | None = None
    task: asyncio.Task[None] | None = None
    # Why the last connection ended, and not before when there is another, by the loop's clock.
    why: str = CONNECTING
    retry_at: float = 0.0


# A user and a robot, by id.
Key = tuple[int, int]


class RouteRunner:
    """All routes."""

    def __init__(
        self,
        context: SessionContext,
        cell_sources: CellSources,
        apps: Apps,
        event_writer: EventWriter,
        snapshot: Callable[[], Snapshot],
    ) -> None:
        self._context = context
        self._cell_sources = cell_sources
        self._peers = cell_sources.peers
        self._apps = apps
        self._event_writer = event_writer
        self._snapshot = snapshot
        self._routes: dict[int, RelayRoute] = {}
        # Those that have ended here, until the database has it.
        self._ended: set[int] = set()
        self._running: dict[Key, RunningRoutes] = {}
        # Those that lead to apps, by id.
        self._to_apps: dict[int, tuple[App, RouteSource]] = {}
        self._is_closing = False

    def restore(self, ends: Iterable[RouteEnd]) -> None:
        """Take over what the relay before this one ended and had not written."""
        self._ended.update(end.route_id for end in ends)

    def on_routes(self, routes: Sequence[RelayRoute]) -> None:
        """These are the routes that last; robots and rights are no older."""
        lasting = {route.id: route for route in routes}
        soon = utc_now() + CLOCKS_DIFFER
        for route in self._routes.values():
            # The database may see first that its time is over. Of one that was removed nothing is written.
            if route.id not in lasting and route.ends_at is not None and route.ends_at <= soon:
                self._end(route, "expired")
        self._routes = lasting
        self._ended &= self._routes.keys()
        self.update()

    def on_robot_change(self, change: Change) -> None:
        """Something happened to a robot."""
        if change.what in {"connected", "disconnected"}:
            self.update()

    async def run(self) -> None:
        """Try again what failed, and end what is over, for ever."""
        while True:
            await asyncio.sleep(CHECK_EVERY_S)
            self.update()

    async def close(self) -> None:
        """Run nothing any more; the routes last."""
        self._is_closing = True
        tasks = [running.task for running in self._running.values() if running.task is not None]
        for running in list(self._running.values()):
            self._keep_only(running, ())
        self._update_apps({})
        await asyncio.gather(*tasks, return_exceptions=True)

    def count(self) -> int:
        """How many routes run here."""
        return len(self._to_apps) + sum(
            len(running.sources)
            for running in self._running.values()
            if running.driver is not None and running.driver.is_connected
        )

    def live(self, user_id: int) -> LiveRouteList:
        """Describe the routes whose robots the user may see, and the user's apps, as this cell knows them."""
        snapshot = self._snapshot()
        routes = [
            self._describe(route)
            for route in self._routes.values()
            if route.id not in self._ended
            and all(snapshot.level(user_id, each) is not None for each in route.robot_ids)
        ]
        return LiveRouteList(routes, [app.describe() for app in self._apps.of_user(user_id)])

    def readable(self, route_id: int) -> ReadableSource | None:
        """Return a route that lasts and whose source is here, for the cell that has its target; None: there is none."""
        snapshot, route = self._snapshot(), self._routes.get(route_id)
        if route is None or route_id in self._ended or _why_over(route, snapshot, utc_now()):
            return None
        source_id = route.source_id
        if source_id is None:
            app = self._app(route, route.source_app)
            return None if app is None else ReadableSource(route, app, self._is_drive(route))
        if self._peers.owner(source_id) is not None:
            return None
        if not self._context.handlers.registry.presence(source_id).online:
            return None
        return ReadableSource(route, snapshot.robots[source_id], self._is_drive(route))

    def _is_drive(self, route: RelayRoute) -> bool:
        """Return whether a route leads to a drive topic."""
        robot = self._snapshot().robots.get(route.target_id or 0)
        return robot is not None and robot.settings.guard.drive_topics.match(route.target_topic)

    def update(self) -> None:
        """Bring what runs in line with what may run."""
        if self._is_closing:
            return
        snapshot, now = self._snapshot(), utc_now()
        ready: dict[Key, list[RelayRoute]] = {}
        to_apps: dict[int, RelayRoute] = {}
        loop = asyncio.get_running_loop()
        for route in list(self._routes.values()):
            if route.id in self._ended:
                continue
            if (code := _why_over(route, snapshot, now) or self._why_not_ours(route)) is not None:
                self._end(route, code)
            elif self._where(route) is not None:
                continue
            elif route.target_id is None:
                to_apps[route.id] = route
            else:
                ready.setdefault((route.user_id, route.target_id), []).append(route)
        for key, running in list(self._running.items()):
            routes = ready.get(key, ())
            self._keep_only(
                running, [route.id for route in routes if self._is_current(route, running)]
            )
            if running.task is None and not routes and loop.time() >= running.retry_at:
                del self._running[key]
        for key, routes in ready.items():
            self._run_all(key, routes, snapshot)
        self._update_apps(to_apps)

    def _update_apps(self, routes: Mapping[int, RelayRoute]) -> None:
        """Send apps what these routes bring, and nothing more of others."""
        for route_id, (app, source) in list(self._to_apps.items()):
            if route_id not in routes or source.rules != self._rules(routes[route_id]):
                del self._to_apps[route_id]
                app.remove(source)
                source.close(self._context.rules.shared_topics)
        for route in routes.values():
            target = self._app(route, route.target_app)
            if target is not None and route.id not in self._to_apps:
                source = self._open(route, target.wake)
                self._to_apps[route.id] = target, source
                target.add(source)

    def _run_all(self, key: Key, routes: list[RelayRoute], snapshot: Snapshot) -> None:
        robot = snapshot.robots[key[1]]
        running = self._running.setdefault(key, RunningRoutes(robot))
        loop = asyncio.get_running_loop()
        if running.task is None and loop.time() >= running.retry_at:
            running.robot, running.driver = robot, RouteDriver(robot, self._context.rules.traffic)
            connection = _connection_of(routes[0], robot, running.driver)
            running.task = loop.create_task(
                self._drive(running, running.driver, connection), name=f"routes to {robot.name}"
            )
        for route in routes:
            if route.id not in running.sources and running.driver is not None:
                source = running.sources[route.id] = self._open(route, running.driver.wake)
                running.driver.add(source)

    def _open(self, route: RelayRoute, wake: Callable[[], None]) -> RouteSource:
        """Let a route read its source: a robot here or at another cell, or an app."""
        shared_topics, robot_id = self._context.rules.shared_topics, route.source_id
        bring = self._cell_sources.bring
        source = RouteSource(route, wake, is_drive=self._is_drive(route), rules=self._rules(route))
        try:
            if robot_id is None:
                if (app := self._app(route, route.source_app)) is not None:
                    source.follow(app.read, app.leave, app.address)
                elif (elsewhere := self._cell_sources.app(route)) is not None:
                    source.bring(bring, elsewhere[1].address)
            elif self._peers.owner(robot_id) is None:
                source.open(self._snapshot().robots[robot_id], shared_topics)
            else:
                source.request(self._snapshot().robots[robot_id])
                source.bring(bring)
        except RobotetherError as problem:
            source.problem = problem.detail
        return source

    def _app(self, route: RelayRoute, name: str | None) -> App | None:
        """Return an app of the route's maker, if it is connected."""
        return None if name is None else self._apps.get(route.user_id, name)

    def _is_current(self, route: RelayRoute, running: RunningRoutes) -> bool:
        """Return whether a route reads its source where and as it may now."""
        source = running.sources.get(route.id)
        return source is None or source.rules == self._rules(route)

    def _rules(self, route: RelayRoute) -> object:
        """Return what a route's connections depend on."""
        apps = (self._app(route, route.source_app), self._app(route, route.target_app))
        peer = self._cell_sources.owner(route)
        cell = None if peer is None else peer.name
        if route.source_id is None:
            return cell, apps
        robot = self._snapshot().robots[route.source_id]
        return robot.name, robot.settings.policy, cell, apps

    def _keep_only(self, running: RunningRoutes, route_ids: Iterable[int]) -> None:
        """Publish nothing more of other routes; without any the robot is released."""
        for route_id in running.sources.keys() - set(route_ids):
            source = running.sources.pop(route_id)
            source.close(self._context.rules.shared_topics)
            if running.driver is not None:
                running.driver.remove(source)
        if not running.sources and running.driver is not None:
            running.driver.end(close_reasons.client_left(running.robot.name))

    async def _drive(
        self, running: RunningRoutes, driver: RouteDriver, connection: Connection
    ) -> None:
        """Drive the robot until something ends that."""
        close_reason = close_reasons.relay_failed()
        try:
            close_reason = await self._drive_until_ended(driver, connection)
        except Exception:
            log.exception("robot %s: routes failed", connection.robot.name)
        finally:
            self._on_ended(running, close_reason)

    async def _drive_until_ended(self, driver: RouteDriver, connection: Connection) -> CloseReason:
        handlers = self._context.handlers
        if (why := handlers.connections.no_room(connection)) is not None:
            return close_reasons.too_many_connections(why)
        # Also while it waits: other rights or settings end it, the robot's clock is known when it begins, and the robot
        # stays at this machine of the site.
        with (
            handlers.connections.joined(connection),
            handlers.registry.ensure_robot(connection.robot.id).usage.counted(),
        ):
            if (close_reason := await driver.wait()) is not None:
                return close_reason
            session = OperatorSession(driver, connection, None, self._context, driver.address)
            return await session.run()

    def _on_ended(self, running: RunningRoutes, close_reason: CloseReason) -> None:
        routes = [source.route for source in running.sources.values()]
        # Also a lease whose routes are away: an app that comes and goes begins one after the other.
        pauses = routes or running.driver is None or not running.driver.is_waiting
        running.task = None
        self._keep_only(running, ())
        running.driver = None
        running.why = close_reason.reason
        if pauses:
            running.retry_at = asyncio.get_running_loop().time() + RETRY_AFTER_S
        if close_reason.name in LASTING_ENDS:
            for route in routes:
                self._end(route, close_reason.name)

    def _end(self, route: RelayRoute, code: str) -> None:
        """End a route for good."""
        if route.id in self._ended:
            return
        self._ended.add(route.id)
        source = self._name_of(route.source_id, route.source_app)
        target = self._name_of(route.target_id, route.target_app)
        log.info("route %d of %s ended: %s", route.id, route.user_name, code)
        self._event_writer.add(RouteEnd(route.id, utc_now(), code, route.user_name, source, target))

    def _name_of(self, robot_id: int | None, app: str | None) -> str:
        """Name an end of a route; a robot that is gone has no name."""
        robot = self._snapshot().robots.get(robot_id or 0)
        return f"{APP}{app}" if app is not None else "" if robot is None else robot.name

    def _why_not_ours(self, route: RelayRoute) -> str | None:
        """Return why nothing may drive the target for the route; None: it is free, driven by routes, or an app."""
        if route.target_id is None:
            return None
        if self._context.control.stops.of(route.target_id) is not None:
            return "robot_stopped"
        driver = self._context.control.leasing.of(route.target_id).driver
        # A call over HTTP holds the lease for a moment.
        is_free = driver is None or driver.holder.is_call or driver.holder.is_route
        return None if is_free else "lease_held"

    def _where(self, route: RelayRoute) -> LiveRoute | None:
        """Say why a route does not run here; None: its target is here, and its source, too, or at another cell."""
        peers, registry = self._peers, self._context.handlers.registry
        for robot_id in route.robot_ids:
            if peers.owner(robot_id) is None and not registry.presence(robot_id).online:
                name = self._name_of(robot_id, None) or "a robot"
                return LiveRoute(route.id, "waits", 0.0, f"{name} is offline")
        if route.target_id is not None and peers.owner(route.target_id) is not None:
            return LiveRoute(route.id, "elsewhere")
        for app in (route.source_app, route.target_app):
            if app is None or self._app(route, app) is not None:
                continue
            if app == route.target_app and peers.count():
                return LiveRoute(route.id, "elsewhere")
            if app == route.target_app or self._cell_sources.app(route) is None:
                return LiveRoute(route.id, "waits", 0.0, f"app {app} is not connected")
        return None

    def _describe(self, route: RelayRoute) -> LiveRoute:
        if (elsewhere := self._where(route)) is not None:
            return elsewhere
        if route.id in self._to_apps:
            _, to_app = self._to_apps[route.id]
            return LiveRoute(route.id, "runs", to_app.rate_hz(), to_app.problem)
        running = self._running.get((route.user_id, route.target_id or 0))
        source = None if running is None else running.sources.get(route.id)
        if running is None or source is None or running.driver is None:
            return LiveRoute(route.id, "waits", 0.0, CONNECTING if running is None else running.why)
        if not running.driver.is_connected:
            idle = f"app {route.source_app} sends nothing, and the robot is free"
            why = (source.problem or idle) if running.driver.is_waiting else running.why
            return LiveRoute(route.id, "waits", 0.0, why)
        return LiveRoute(route.id, "runs", source.rate_hz(), source.problem)


def _connection_of(route: RelayRoute, robot: RelayRobot, driver: RouteDriver) -> Connection:
    """Return the connection of all routes of a user into a robot; making one needs the level manage."""
    # What people read as the driver; no user can have such a name.
    name = f"{route.user_name} (route)"
    return Connection(
        route.user_id, name, robot, "drive", driver.end, level="manage", is_route=True
    )


def _why_over(route: RelayRoute, snapshot: Snapshot, now: datetime) -> str | None:
    """Return why a route must end now; None: it may go on."""
    if route.ends_at is not None and route.ends_at <= now:
        return "expired"
    for robot_id in route.robot_ids:
        if snapshot.level(route.user_id, robot_id) != "manage":
            return "rights_ended"
        robot = snapshot.robots.get(robot_id)
        if robot is None or robot.state != "active":
            return "robot_inactive"
    return None
