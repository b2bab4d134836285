"""The relay's process: builds its parts, and starts and stops them in order.

Tests run several relays in their own process. Each thing that happens to a robot passes here once, and reaches
connections, control, fleet events and observers from here.
"""

from __future__ import annotations

import asyncio
import logging
import os
import resource
import signal
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import uvloop
from aiohttp import ClientSession, ClientWebSocketResponse, DummyCookieJar, TCPConnector, web

from robotether_server.backups import RECORD
from robotether_server.db import Database
from robotether_server.db.fleet import FormerSessions, Snapshot
from robotether_server.problems import SettingsError, StoreProblem
from robotether_server.relay.app import (
    Cors,
    Handlers,
    inside_app,
    peer_app,
    public_app,
    server_log,
)
from robotether_server.relay.auth.access import Access
from robotether_server.relay.auth.connections import Connections
from robotether_server.relay.auth.credentials import Credentials
from robotether_server.relay.cells.cells import Cells
from robotether_server.relay.cells.dialer import PeerDialer
from robotether_server.relay.cells.drain import CellDrain, DrainRules
from robotether_server.relay.cells.feed import PeerFeed, PeerFeedHandler
from robotether_server.relay.cells.forwarding import Forwarding
from robotether_server.relay.cells.keys import PeerKeys, read_peer_keys
from robotether_server.relay.cells.peers import Peers
from robotether_server.relay.cells.rebalancing import BalanceRules, Rebalancing
from robotether_server.relay.channels.events import EventsHandler, FleetEvents
from robotether_server.relay.channels.rosbridge.bridge import Traffic
from robotether_server.relay.channels.rosbridge.handler import BridgeRules, RosbridgeHandler
from robotether_server.relay.channels.video.feed_link import FeedConnector
from robotether_server.relay.channels.video.feeds import Feeds
from robotether_server.relay.channels.video.frames_handler import FramesHandler
from robotether_server.relay.channels.video.handler import VideoHandler
from robotether_server.relay.channels.video.viewers import VideoContext
from robotether_server.relay.control.control import Control
from robotether_server.relay.control.control_api import ControlApi, OtherCells
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.event_loop import EventLoop, watched
from robotether_server.relay.http.sockets import RobotSocket, refuse_redirects
from robotether_server.relay.http.timing import DRIVER_LIMITS, LivenessLimits
from robotether_server.relay.metrics import Metrics
from robotether_server.relay.observers import RelayObserver
from robotether_server.relay.records.database import RelayDatabase
from robotether_server.relay.records.event_writer import EventWriter
from robotether_server.relay.records.fleet import Fleet
from robotether_server.relay.records.journal import Journal
from robotether_server.relay.robots.port_checks import PortChecker
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot_link import LinkRules
from robotether_server.relay.robots.session_server import BACKLOG, SessionServer
from robotether_server.settings import RelaySettings, load
from robotether_server.tickets import TicketSigner
from robotether_server.times import utc_now

log = logging.getLogger(__name__)

LOG_FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"

# All of stopping together takes under 3 s.
HANDLERS_STOP_WITHIN_S = 1.0
EVENTS_WRITTEN_WITHIN_S = 0.7
# A robot that comes from another cell waits so long for what the database has of it.
CONTROL_READ_WITHIN_S = 1.0
# A whole fleet may come at once; others ask the database, too.
CONTROL_READS_AT_ONCE = 8
# For its next transactions; the accounts of the database have few for all cells.
KEPT_CONNECTIONS = 2
# sshd may come back with another address.
NAMES_KEPT_S = 2
# In a volume of the relay's own.
JOURNAL = Path("/var/lib/robotether/relay/journal.jsonl")


@dataclass(frozen=True)
class Listen:
    """Where the relay listens; tests give port 0."""

    host: str = "0.0.0.0"  # noqa: S104  # compose publishes none of these ports
    http_port: int = 8080
    session_port: int = 8091
    peer_port: int = 8092
    inside_port: int = 9100


@dataclass(frozen=True)
class Timing:
    """Times that tests shorten."""

    limits: LivenessLimits = field(default_factory=LivenessLimits)
    driver_limits: LivenessLimits = DRIVER_LIMITS
    heartbeat_s: float = 0.5
    idle_heartbeat_s: float = 2.0
    timeout_s: float = 5.0
    poll_every_s: float = 1.0
    drives_every_s: float = 10.0
    drain: DrainRules = field(default_factory=DrainRules)
    balance: BalanceRules = field(default_factory=BalanceRules)


class Relay:
    """All parts of the relay; made and run in one event loop."""

    def __init__(
        self,
        settings: RelaySettings,
        database: RelayDatabase,
        *,
        listen: Listen | None = None,
        timing: Timing | None = None,
        peer_keys: PeerKeys | None = None,
        journal: Path | None = None,
    ) -> None:
        self._settings = settings
        self._peer_keys = peer_keys
        self._journal = None if journal is None else Journal(journal)
        self._database = database
        self._listen = listen or Listen()
        self._timing = timing or Timing()
        self._tasks: list[asyncio.Task[None]] = []
        self._control_reads = asyncio.Semaphore(CONTROL_READS_AT_ONCE)
        self._runners: list[web.AppRunner] = []
        self.http_port = 0
        self.peer_port = 0
        self.inside_port = 0
        self._make_state()
        self._make_control()
        self._make_events()
        self._make_client()
        self._make_feeds()
        self._make_sessions()
        self._make_apps()
        self._add_gauges()

    @property
    def session_port(self) -> int:
        """Where robots' sessions arrive."""
        return self._sessions.port

    async def start(self) -> None:
        """Read the records once, if they can be read, and listen."""
        for stops in self.event_writer.restore():
            self.control.stops.restore(stops)
        self.event_writer.add(FormerSessions(before=utc_now()))
        await asyncio.gather(self.fleet.poll(), self.cells.poll())
        self._tasks = [
            asyncio.create_task(self.cells.run(), name="cells"),
            asyncio.create_task(self.cell_drain.run(), name="cell_drain"),
            asyncio.create_task(self.rebalancing.run(), name="rebalancing"),
            asyncio.create_task(self.fleet.run(), name="fleet"),
            asyncio.create_task(self.event_writer.run(), name="event_writer"),
            asyncio.create_task(self._write_drives(), name="drives"),
            asyncio.create_task(self._read_stops(), name="stops"),
        ]
        for task in self._tasks:
            task.add_done_callback(_report_end)
        listen = self._listen
        self.inside_port = await self._serve(self._inside, listen.inside_port)
        self.http_port = await self._serve(self._public, listen.http_port)
        if self._peer_app is not None:
            self.peer_port = await self._serve(self._peer_app, listen.peer_port)
        if self._peer_dialer is not None:
            self._peer_dialer.start()
        await self._sessions.start(listen.host, listen.session_port)
        log.info("listening on %s: %d and %d", listen.host, self.http_port, self.session_port)

    async def stop(self) -> None:
        """Notify operators, then robots, and write the rest down."""
        self.connections.end_all(close_reasons.relay_stopping())
        self.fleet_events.end_subscriptions()
        # Operators first: they must be notified that the relay stops, and not that a link was lost.
        await asyncio.gather(*(runner.cleanup() for runner in self._runners))
        await self.feeds.close()
        await self._sessions.stop()
        if self._peer_dialer is not None:
            await self._peer_dialer.stop()
        self.registry.close()
        await self.event_writer.flush(EVENTS_WRITTEN_WITHIN_S)
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self.event_writer.close()
        await self._client.close()
        self._database.close()

    def _make_state(self) -> None:
        """Make what knows who is connected, and what they use."""
        self.traffic = Traffic()
        self.metrics = Metrics(self.traffic)
        # Published ports, as in the paper, are there for whoever connects to them.
        self.registry = SessionRegistry(always_needed=self._settings.direct)
        self.connections = Connections(self.registry)

    def _make_control(self) -> None:
        """Make what the database has a part in: cells, who drives, robots and rights."""
        database, registry = self._database, self.registry
        self.event_writer = EventWriter(database, journal=self._journal)
        self.credentials = Credentials(database)
        self.cells = Cells(
            self._settings.cell,
            database,
            registry.online_count,
            region_of=self._region_of,
            poll_every_s=self._timing.poll_every_s,
        )
        self.control = Control(
            database=database,
            event_writer=self.event_writer,
            registry=registry,
            snapshot=lambda: self.fleet.known,
            robots_leave=lambda: self.cells.robots_leave,
        )
        self.cell_drain = CellDrain(self.cells, registry, rules=self._timing.drain)
        self.rebalancing = Rebalancing(
            self.cells,
            registry,
            unreached=self._cells_unreached,
            rules=self._timing.balance,
        )
        self.fleet = Fleet(
            database,
            rights_changed=self._on_snapshot,
            credentials_changed=self.credentials.recheck,
            check_new_credentials=self.credentials.check_new,
            last_seen=registry.remember,
            on_stored_control=self.control.remember,
            poll_every_s=self._timing.poll_every_s,
        )

    def _make_events(self) -> None:
        """Make what follows robots, here and at other cells, and say who is notified when."""
        self.peers = Peers(self.registry, self.control.stops, self._on_elsewhere)
        self.fleet_events = FleetEvents(
            lambda: self.fleet.known,
            self.registry,
            self.connections,
            self.control,
            elsewhere=self.peers.described,
        )
        self.observer = RelayObserver(
            self.event_writer, self.metrics, self.registry, lambda: self.fleet.known
        )
        # First those whose link is lost or whose robot is stopped, then those who watch, then the records.
        self.registry.listen(
            self.connections.on_robot_change,
            self.control.on_robot_change,
            self.fleet_events.on_robot_change,
            self.observer.on_robot_change,
            self.peers.on_robot_change,
        )
        self.connections.listen(self.fleet_events.changed)
        self.control.listen(self.fleet_events.changed)

    def _region_of(self, robot_id: int) -> str | None:
        robot = self.fleet.known.robots.get(robot_id)
        return None if robot is None else robot.settings.region

    def _on_snapshot(self, snapshot: Snapshot) -> None:
        # Operators first: they must be notified that their right ended, and not that a link was lost.
        self.connections.end_unrighted(snapshot)
        self.control.on_snapshot(snapshot)
        self._sessions.on_snapshot(snapshot)
        self.registry.forget_all_but(snapshot.robots)
        self.fleet_events.all_changed()

    def _make_client(self) -> None:
        """Make the HTTP client towards robots; it keeps no connection and no cookie."""
        connector = TCPConnector(limit=0, force_close=True, ttl_dns_cache=NAMES_KEPT_S)
        self._client = ClientSession(
            connector=connector,
            cookie_jar=DummyCookieJar(),
            auto_decompress=False,
            trace_configs=[refuse_redirects()],
            # aiohttp declares the class for text that it decodes; ours never does.
            ws_response_class=cast(type[ClientWebSocketResponse], RobotSocket),
        )

    def _make_feeds(self) -> None:
        connector = FeedConnector(self._client, self._settings.tunnel_host, self.registry)
        self.feeds = Feeds(self.registry, connector.start)
        self.metrics.collect_feeds(self.feeds.traffic)
        self.registry.listen(self.feeds.on_robot_change)

    def _make_sessions(self) -> None:
        settings, timing = self._settings, self._timing
        self._sessions = SessionServer(
            registry=self.registry,
            snapshot=lambda: self.fleet.snapshot,
            refresh=self.fleet.poll,
            session_key=settings.session_key,
            rules=LinkRules(
                settings.tunnel_host,
                greeting=self.control.greeting,
                cells=self.cells.addresses,
                heartbeat_s=timing.heartbeat_s,
                idle_heartbeat_s=timing.idle_heartbeat_s,
                timeout_s=timing.timeout_s,
                direct=settings.direct,
                prepare=self._read_control,
            ),
            checker=PortChecker(settings.tunnel_host, self.observer.port_checked),
            refused=self.observer.session_refused,
        )
        self.cells.listen(self._sessions.on_cells)

    def _make_apps(self) -> None:
        settings = self._settings
        access = Access(
            signer=TicketSigner(settings.tickets.key, settings.tickets.ttl_s),
            credentials=self.credentials,
            snapshot=lambda: self.fleet.snapshot,
            allowed_origins=settings.allowed_origins,
            clock=utc_now,
            online_s=self._online_s,
        )
        context = VideoContext(
            access=access,
            credentials=self.credentials,
            registry=self.registry,
            connections=self.connections,
            client=self._client,
            tunnel_host=settings.tunnel_host,
            feeds=self.feeds,
        )
        rosbridge = RosbridgeHandler(
            context,
            self.control,
            rules=self._bridge_rules(),
            report=self.observer.connection,
        )
        frames, video = FramesHandler(context, self._timing.limits), VideoHandler(context)
        events = EventsHandler(
            access, self.credentials, self.fleet_events, lambda: self.connections.caps.per_user
        )
        control = ControlApi(
            access,
            self.control,
            lambda: self.fleet.snapshot,
            OtherCells(self.peers.confirmation, self._cells_unreached),
        )
        handlers = Handlers(rosbridge, frames, video, events, control)
        cors, forwarding = (
            Cors(settings.allowed_origins),
            Forwarding(self.peers, self._known, access),
        )
        self._public = public_app(self.metrics, handlers, cors, forwarding)
        self._make_peers(handlers, cors)
        self._inside = inside_app(self.metrics, lambda: self.fleet.store_up, self.peers.addresses)

    def _make_peers(self, handlers: Handlers, cors: Cors) -> None:
        """Serve other cells, and follow them, if this one has what to show them."""
        cell, keys = self._settings.cell, self._peer_keys
        self._peer_feeds = PeerFeedHandler(
            cell.name,
            self.fleet_events,
            lambda: PeerFeed(self.fleet_events, self.registry),
        )
        self._peer_app, self._peer_dialer = None, None
        if keys is not None:
            self._peer_app = peer_app(
                self.metrics, handlers, cors, keys=keys, feed=self._peer_feeds
            )
            if cell.peer_address is not None:
                self._peer_dialer = PeerDialer(self.cells, self.peers, keys)

    def _on_elsewhere(self, robot_id: int) -> None:
        self.fleet_events.changed(robot_id)

    def _known(self) -> Snapshot:
        return self.fleet.known

    def _online_s(self, robot_id: int) -> float | None:
        """Return for how long a robot has been here that may have been at another cell before."""
        connected_at = self.registry.presence(robot_id).connected_at
        if connected_at is None or not self.cells.peers():
            return None
        return time.monotonic() - connected_at

    def _cells_unreached(self) -> list[str]:
        cells = self.cells.peers()
        return [cell.name for cell in cells if not self._peer_feeds.is_followed_by(cell.name)]

    async def _read_control(self, robot_id: int) -> None:
        """Read what another cell wrote of a robot that begins a session here."""
        if not self.cells.peers():
            return
        try:
            async with asyncio.timeout(CONTROL_READ_WITHIN_S), self._control_reads:
                self.control.remember(await self._database.stored_control(robot_id))
        except (StoreProblem, TimeoutError):
            # Then it counts what other cells and the guard reported.
            log.info("robot %d: its stop and number could not be read", robot_id)
        except Exception:
            # Nor does any other answer of the database keep a robot out.
            log.exception("robot %d: its stop and number could not be read", robot_id)

    async def _read_stops(self) -> None:
        """Read what other cells wrote while one of them is not connected: a stop must not wait for the connection."""
        while True:
            await asyncio.sleep(self._timing.poll_every_s)
            if self.peers.count() >= len(self.cells.peers()):
                continue
            try:
                self.control.remember(await self._database.stored_control())
            except StoreProblem:
                # `fleet` says in the log that the database is away.
                continue
            except Exception:
                log.exception("cannot read the stops of other cells; the next try may succeed")

    def _bridge_rules(self) -> BridgeRules:
        timing, limit = self._timing, self._settings.message_limit_bytes
        return BridgeRules(timing.limits, timing.driver_limits, limit, self.traffic)

    async def _write_drives(self) -> None:
        while True:
            await asyncio.sleep(self._timing.drives_every_s)
            self.observer.write_drives()

    def _add_gauges(self) -> None:
        gauge, connections = self.metrics.gauge, self.connections
        gauge("robots_online", "Robots with a session", self.registry.online_count)
        gauge("media_links", "Robots' media connections", lambda: self.registry.count("media"))
        gauge("shell_links", "Robots' shell connections", lambda: self.registry.count("shell"))
        gauge("leases", "Robots that somebody drives", self.control.leasing.count)
        gauge("robots_stopped", "Robots that are stopped", self.control.stops.count)
        gauge("drivers", "Connections that drive", lambda: connections.count("drive"))
        gauge("observers", "Connections that observe", lambda: connections.count("observe"))
        gauge("video_streams", "Video answers under way", lambda: connections.count("video"))
        gauge("video_feeds", "Cameras that are watched", self.feeds.count)
        gauge("cells_connected", "Other cells that are connected", self.peers.count)
        gauge("robots_elsewhere", "Robots of other cells", self.peers.robot_count)
        gauge("event_clients", "Clients of the live fleet", self.fleet_events.subscriber_count)
        gauge("store_up", "1 when the database answers", lambda: self.fleet.store_up)
        gauge("journal_waiting", "Entries not yet written", self.event_writer.waiting)
        gauge("journal_dropped", "Entries given up", lambda: self.event_writer.dropped)
        self.metrics.collect_backups(RECORD)

    async def _serve(self, app: web.Application, port: int) -> int:
        runner = web.AppRunner(
            app,
            access_log=None,
            logger=server_log,
            handler_cancellation=True,
            shutdown_timeout=HANDLERS_STOP_WITHIN_S,
        )
        self._runners.append(runner)
        await runner.setup()
        await web.TCPSite(runner, self._listen.host, port, backlog=BACKLOG).start()
        return int(runner.addresses[0][1])


def _report_end(task: asyncio.Task[None]) -> None:
    """Say that a part failed that runs for ever; nobody awaits it before the relay stops."""
    if not task.cancelled() and (problem := task.exception()) is not None:
        log.critical("task %s failed; restart the relay", task.get_name(), exc_info=problem)


def main() -> None:
    """Run until SIGTERM or SIGINT."""
    try:
        settings = load(RelaySettings, os.environ)
    except SettingsError as problem:
        sys.exit(problem.detail)
    logging.basicConfig(level=settings.log_level.upper(), format=LOG_FORMAT)
    raise_open_files()
    uvloop.run(watched(run(settings, Listen(), JOURNAL)), loop_factory=EventLoop)
    logging.shutdown()
    # Threads that wait for a database that hangs would hold the interpreter's exit.
    os._exit(0)


def raise_open_files() -> None:
    """Allow this process as many as it may have: Docker 29 begins with 1024, and a fleet has more connections."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


async def run(settings: RelaySettings, listen: Listen, journal: Path | None = None) -> None:
    """Run a relay until the process is asked to stop."""
    stopped = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stopped.set)
    relay = Relay(
        settings,
        RelayDatabase(Database(settings.database, keep=KEPT_CONNECTIONS), settings.cell.name),
        listen=listen,
        peer_keys=read_peer_keys(),
        journal=journal,
    )
    await relay.start()
    await stopped.wait()
    log.info("stopping")
    await relay.stop()
