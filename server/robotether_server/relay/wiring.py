"""Makes the relay's parts, each from those above it, and says who is notified of what.

`main` and tests make one `Relay`, and start and stop it.
"""

from __future__ import annotations

import asyncio
import logging
from functools import partial
from secrets import token_hex

from aiohttp import web

from robotether_server.audit_chain import server_key
from robotether_server.db.fleet import FormerSessions
from robotether_server.relay.app import Servers, inside_app, peer_app, public_app
from robotether_server.relay.auth.access import Access
from robotether_server.relay.auth.connections import Connections
from robotether_server.relay.auth.credentials import Credentials
from robotether_server.relay.cells import cell_metrics, cell_topics
from robotether_server.relay.cells.cell_client import CellClient, CellTopicDialer
from robotether_server.relay.cells.cells import Cells
from robotether_server.relay.cells.dialer import PeerDialer
from robotether_server.relay.cells.drain import CellDrain
from robotether_server.relay.cells.feed import FLEET_PATH, PeerFeedHandler
from robotether_server.relay.cells.forwarded_observers import ForwardedObservers
from robotether_server.relay.cells.forwarding import Forwarding
from robotether_server.relay.cells.keys import PeerKeys
from robotether_server.relay.cells.peers import Peers
from robotether_server.relay.cells.rebalancing import Rebalancing
from robotether_server.relay.cells.stored_control import StoredControlReader
from robotether_server.relay.channels import recorder
from robotether_server.relay.channels.kinds import channel_routes
from robotether_server.relay.channels.rosbridge.bridge import Traffic
from robotether_server.relay.channels.rosbridge.handler import BridgeRules, SessionContext
from robotether_server.relay.channels.rosbridge.shared_topics import SharedTopics
from robotether_server.relay.channels.rosbridge.topic_link import TopicLinks
from robotether_server.relay.channels.video.feed_link import bring_frames
from robotether_server.relay.channels.video.feeds import Feeds
from robotether_server.relay.channels.video.viewers import VideoContext
from robotether_server.relay.control.control import Control
from robotether_server.relay.control.control_api import ControlApi
from robotether_server.relay.control.fleet_events import FleetEvents
from robotether_server.relay.control.head_signer import HeadSigner
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.event_loop import start_task
from robotether_server.relay.http.sockets import robot_client
from robotether_server.relay.metrics import Metrics, read_feeds, read_help_requests
from robotether_server.relay.observers import RelayObserver
from robotether_server.relay.options import Listen, Timing
from robotether_server.relay.records.database import RelayDatabase
from robotether_server.relay.records.event_writer import EventWriter
from robotether_server.relay.records.fleet import Fleet
from robotether_server.relay.records.journal import Journal
from robotether_server.relay.robots.media_dialer import MediaDialer
from robotether_server.relay.robots.port_checks import PortChecker
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot_dialer import RobotDialer
from robotether_server.relay.robots.robot_link import LinkRules
from robotether_server.relay.robots.session_server import BACKLOG, SessionServer
from robotether_server.relay.routes import apps, cell_sources, live_routes
from robotether_server.relay.routes.routes import RouteRunner
from robotether_server.settings.server import RelaySettings
from robotether_server.tasks import end_tasks
from robotether_server.times import utc_now

log = logging.getLogger(__name__)


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
        journal: Journal | None = None,
    ) -> None:
        self._settings = settings
        self.database = database
        self._listen = listen or Listen()
        self._timing = timing or Timing()
        self._tasks: list[asyncio.Task[None]] = []
        self._servers = Servers(self._listen.host, BACKLOG)
        self.http_port = self.session_port = self.peer_port = self.inside_port = 0

        # Published ports, as in the paper, are there for whoever connects to them.
        self.registry = SessionRegistry(always_needed=settings.direct)
        self.connections = Connections(self.registry)
        self.event_writer = EventWriter(database, journal=journal)
        self.credentials = Credentials(database)
        self.fleet = Fleet(database, self.credentials, poll_every_s=self._timing.poll_every_s)
        self._make_control()
        self._make_channels(peer_keys)
        self._make_sessions()
        self._make_apps(peer_keys)
        self._notify()
        self._count()

    async def start(self) -> None:
        """Read the records once, if they can be read, and listen."""
        stops, route_ends = self.event_writer.restore()
        self.control.stops.restore(stops)
        self.routes.restore(route_ends)
        self.event_writer.add(FormerSessions(before=utc_now()))
        await asyncio.gather(self.fleet.poll(), self.cells.poll())
        self._tasks = [
            start_task("cells", self.cells.run()),
            start_task("disk", self.cells.watch_disk(self.event_writer.folder)),
            start_task("cell_drain", self.cell_drain.run()),
            start_task("rebalancing", self.rebalancing.run()),
            start_task("fleet", self.fleet.run()),
            start_task("event_writer", self.event_writer.run()),
            start_task("head_signer", self.head_signer.run()),
            start_task("drives", self.observer.run(self._timing.drives_every_s)),
            start_task("stops", self.stored_control.run()),
            start_task("routes", self.routes.run()),
            start_task("connections", self.database.count_connections()),
        ]
        listen, serve = self._listen, self._servers.serve
        self.inside_port = await serve(self._inside, listen.inside_port)
        self.http_port = await serve(self._public, listen.http_port)
        if self._peer_app is not None:
            self.peer_port = await serve(self._peer_app, listen.peer_port)
        self.peer_dialer.start()
        self.session_port = await self.sessions.start(listen.host, listen.session_port)
        log.info("listening on %s: %d and %d", listen.host, self.http_port, self.session_port)

    async def stop(self) -> None:
        """Notify operators, then robots, and write the rest down."""
        self.connections.end_all(close_reasons.relay_stopping())
        self.apps.end_all(close_reasons.relay_stopping())
        await self.routes.close()
        self.fleet_events.end_subscriptions()
        # Operators first: they must be notified that the relay stops, and not that a link was lost.
        await self._servers.close()
        await asyncio.gather(self.feeds.close(), self.shared_topics.close())
        await self.sessions.stop()
        await self.peer_dialer.stop()
        self.registry.close()
        await self.event_writer.flush()
        await end_tasks(self._tasks)
        self.event_writer.close()
        await self._client.close()
        self.database.close()

    def _make_control(self) -> None:
        """Make the records, the cells, who drives, and who follows all of it."""
        database, registry, fleet = self.database, self.registry, self.fleet
        poll_every_s = self._timing.poll_every_s
        self.traffic = Traffic()
        self.metrics = Metrics(self.traffic)
        self.observer = RelayObserver(self.event_writer, self.metrics, registry, fleet.state)
        key = server_key(self._settings.session_key)
        self.head_signer = HeadSigner(database, registry, fleet.state, key)
        self.cells = Cells(
            self._settings.cell, database, registry.online_count, fleet.region_of, poll_every_s
        )
        self.control = Control(
            database, self.event_writer, registry, fleet.state, self.cells.robots_leave
        )
        self.peers = Peers(registry, self.control.stops, self.cells)
        self.stored_control = StoredControlReader(
            database, self.control, self.cells, self.peers, poll_every_s
        )
        self.fleet_events = FleetEvents(
            fleet.state, registry, self.connections, self.control, self.peers.described
        )
        self.access = Access(
            self._settings, self.credentials, fleet.snapshot, self.peers.here_for_s
        )
        self.recorder_handler = recorder.RecorderHandler(
            self.access, registry, self.fleet_events, fleet.snapshot
        )

    def _make_channels(self, peer_keys: PeerKeys | None) -> None:
        """Make what people, apps and routes reach robots by, here and at other cells."""
        settings, timing, registry = self._settings, self._timing, self.registry
        limit_bytes, host = settings.message_limit_bytes, settings.tunnel_host
        self._client = robot_client()
        self._media = MediaDialer(self._client, host, registry)
        self.feeds = Feeds(registry, partial(bring_frames, self._media))
        topics_key = token_hex(16).encode()
        cells = None if peer_keys is None else CellClient(self._client, peer_keys, topics_key)
        topics = CellTopicDialer(self._media, self.peers, cells)
        topic_links = TopicLinks(topics.open, registry, limit_bytes, topics_key)
        self.shared_topics = SharedTopics(registry, topic_links)
        dialer = RobotDialer(self._client, host, registry, limit_bytes)
        self._context = VideoContext(
            self.access, self.credentials, registry, self.connections, dialer, self.feeds
        )
        rules = BridgeRules(
            timing.limits, timing.driver_limits, limit_bytes, self.traffic, self.shared_topics
        )
        self._session_context = SessionContext(
            self._context, self.control, rules, self.observer.connection
        )
        self.apps = apps.Apps(self.access, self.credentials, self.event_writer, rules)
        self.forwarded_observers = ForwardedObservers(cells, self.peers, self._context, rules)
        sources = cell_sources.CellSources(cells, self.peers, limit_bytes)
        self.routes = RouteRunner(
            self._session_context, sources, self.apps, self.event_writer, self.fleet.state
        )
        self._live_routes = live_routes.LiveRoutes(self.access, self.routes.live, self.peers, cells)
        self._cell_metrics = cell_metrics.CellMetrics(
            settings.cell.name, self.metrics.parts, self.peers, cells
        )
        self._peer_topics = cell_topics.PeerTopicsHandler(
            self.fleet.state, registry, self.peers, rules, topic_links
        )
        self._cell_source_handler = cell_sources.CellSourceHandler(
            self.routes.readable, self.shared_topics, self.traffic.piece_turns
        )

    def _make_sessions(self) -> None:
        """Make what robots connect to, and what sends them to other cells."""
        cells, registry, timing = self.cells, self.registry, self._timing
        self.peer_feeds = PeerFeedHandler(cells, self.fleet_events, registry, self.apps.list_all)
        self.cell_drain = CellDrain(cells, registry, timing.drain)
        self.rebalancing = Rebalancing(cells, registry, self.peer_feeds.unreached, timing.balance)
        self.sessions = SessionServer(
            registry=registry,
            snapshot=self.fleet.snapshot,
            refresh=self.fleet.poll,
            rules=LinkRules(
                self._settings,
                timing,
                greeting=self.control.greeting,
                cells=cells.addresses,
                prepare=self.stored_control.read,
                on_help=self.observer.help_called,
                on_nearer=self.rebalancing.on_nearer,
                on_signed_head=self.head_signer.on_signed_head,
            ),
            checker=PortChecker(self._settings.tunnel_host, self.observer.port_checked),
            refused=self.observer.session_refused,
        )

    def _make_apps(self, peer_keys: PeerKeys | None) -> None:
        """Make what nginx, the inside and other cells are served; the last if this cell has what to show them."""
        settings, metrics = self._settings, self.metrics
        control_api = ControlApi(
            self.access,
            self.control,
            self._media,
            self.fleet.snapshot,
            self.peers.confirmation,
            self.peer_feeds.unreached,
        )
        routes = [
            *channel_routes(self._context, self._session_context, self.fleet_events),
            *control_api.routes(),
            web.get(live_routes.PATH, self._live_routes.show),
            web.get(apps.PATH, self.apps.handle, allow_head=False),
        ]
        forwarding = Forwarding(self.peers, self.fleet.state, self.access, self.forwarded_observers)
        self._public = public_app(settings, metrics, routes, forwarding)
        inside = [
            web.get("/metrics", self._cell_metrics.show),
            web.get(recorder.PATH, self.recorder_handler.handle, allow_head=False),
        ]
        self._inside = inside_app(self.fleet, self.peers.addresses, inside)
        self._peer_app: web.Application | None = None
        self.peer_dialer = PeerDialer(self.cells, self.peers, peer_keys)
        if peer_keys is not None:
            between_cells = [
                web.get(FLEET_PATH, self.peer_feeds.handle, allow_head=False),
                web.get(cell_topics.ROUTE, self._peer_topics.handle, allow_head=False),
                web.get(cell_sources.ROUTE, self._cell_source_handler.handle, allow_head=False),
                web.get(live_routes.CELL_PATH, self._live_routes.show_own, allow_head=False),
                web.get(cell_metrics.PATH, self._cell_metrics.show_own, allow_head=False),
            ]
            public = public_app(settings, metrics, routes)
            self._peer_app = peer_app(public, peer_keys, between_cells)

    def _notify(self) -> None:
        """Say who is notified of what, in which order."""
        self.cells.count_recorders = self.recorder_handler.count
        self.event_writer.on_written = self.head_signer.on_written
        self.fleet.restore_last_seen = self.registry.remember
        self.fleet.restore_control = self.control.remember
        # Operators first: they must be notified that their right ended, and not that a link was lost.
        self.fleet.listen(
            self.connections.on_snapshot,
            self.control.on_snapshot,
            self.sessions.on_snapshot,
            self.registry.on_snapshot,
            self.fleet_events.on_snapshot,
        )
        self.fleet.on_routes = self.routes.on_routes
        self.apps.on_change = self.routes.update
        # First those whose link is lost or whose robot is stopped, then those who watch, then the records.
        self.registry.listen(
            self.connections.on_robot_change,
            self.control.on_robot_change,
            self.fleet_events.on_robot_change,
            self.observer.on_robot_change,
            self.recorder_handler.on_robot_change,
            self.peers.on_robot_change,
            self.feeds.on_robot_change,
            self.shared_topics.on_robot_change,
            self.forwarded_observers.on_robot_change,
            self.routes.on_robot_change,
        )
        self.connections.listen(self.fleet_events.changed)
        self.control.listen(self.fleet_events.changed)
        self.peers.listen(self.fleet_events.changed)
        self.peers.listen(self.forwarded_observers.on_peer_robot)
        self.cells.listen(self.sessions.on_cells)
        self.fleet.help_listeners = (
            self.control.on_help_requests,
            self.fleet_events.on_help_requests,
        )

    def _count(self) -> None:
        """Have the metrics read what the parts know of themselves."""
        gauge, connections, registry = self.metrics.gauge, self.connections, self.registry
        gauge("robots_online", "Robots with a session", registry.online_count)
        gauge("media_links", "Robots' media connections", lambda: registry.count("media"))
        gauge("shell_links", "Robots' shell connections", lambda: registry.count("shell"))
        gauge("leases", "Robots that somebody drives", self.control.leasing.count)
        gauge("robots_stopped", "Robots that are stopped", self.control.stops.count)
        gauge("drivers", "Connections that drive", lambda: connections.count("drive"))
        gauge("observers", "Connections that observe", lambda: connections.count("observe"))
        gauge("video_streams", "Video answers under way", lambda: connections.count("video"))
        gauge("video_feeds", "Cameras that are watched", self.feeds.count)
        gauge("topics", "Topics that robots send", self.shared_topics.count)
        gauge("cells_connected", "Other cells that are connected", self.peers.count)
        gauge("robots_elsewhere", "Robots of other cells", self.peers.robot_count)
        gauge("routes", "Routes between robots and apps that run", self.routes.count)
        gauge("apps", "Web apps that are connected", self.apps.count)
        gauge("event_clients", "Clients of the live fleet", self.fleet_events.subscriber_count)
        gauge("recorders", "Recorders that are connected", self.recorder_handler.count)
        gauge("store_up", "1 when the database answers", lambda: self.fleet.store_up)
        gauge("event_writer_waiting", "Entries not yet written", self.event_writer.waiting)
        gauge("event_writer_dropped", "Entries given up", lambda: self.event_writer.dropped)
        self.metrics.collect(partial(read_feeds, self.feeds.traffic))
        self.metrics.collect_robots(self.fleet.state, registry)
        self.metrics.collect(partial(read_help_requests, self.fleet.known_help_requests))
        self.metrics.collect_parts(self.sessions, self.database, self.cells)
