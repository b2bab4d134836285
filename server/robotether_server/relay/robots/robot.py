"""All that the relay knows of one robot, in memory: who is connected to it, who drives it, and who stopped it.

`registry` makes a `Robot` and drops it, with all that is here. A part of the relay that has to remember something of a
robot keeps it in a field of its own.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Literal, Protocol, get_args

from robotether_common.session import (
    Battery,
    ByeCode,
    GuardState,
    HelpSource,
    Kind,
    ServiceState,
)

from robotether_server.db.cells import SshAddresses
from robotether_server.db.fleet import HelpEntry, SessionEntry
from robotether_server.relay.http.timing import RateLimiter, RobotClock
from robotether_server.relay.robots.connection import Connection
from robotether_server.relay.robots.delivered_frames import DeliveredFrames
from robotether_server.relay.robots.demand import Demand
from robotether_server.relay.robots.drive_log import CameraCounts, DriveLog, ViewerStats
from robotether_server.relay.robots.lease import Lease
from robotether_server.relay.robots.recorders import Recorders
from robotether_server.relay.robots.robot_stops import RobotStops
from robotether_server.relay.robots.session_messages import (
    GuardMode,
    GuardReport,
    Position,
    SeenReport,
)
from robotether_server.relay.robots.uplink import Uplink


class Link(Protocol):
    """One TCP connection of a robot, of one kind."""

    @property
    def robot_id(self) -> int:
        """The robot's id in the database."""

    @property
    def kind(self) -> Kind:
        """What the connection is for."""

    @property
    def address(self) -> str:
        """Where the robot's SSH connection comes from."""

    @property
    def guard_key(self) -> str:
        """What shows the robot's guard that a connection comes from this relay."""

    @property
    def clock(self) -> RobotClock:
        """The robot's clock against ours."""

    def send(self, line: bytes) -> None:
        """Send a line to the agent, if the link still is."""

    def send_cells(self, cells: Sequence[SshAddresses]) -> None:
        """Send where the robot connects next, the best first."""

    def on_media_demand(self) -> None:
        """Viewers of the robot's video came, or the last one left."""

    def on_usage(self) -> None:
        """Somebody is about to use the robot, or the last one left."""

    async def until_quick(self) -> None:
        """Wait until the agent has read that heartbeats are quick."""

    async def until_guard_reported(self) -> None:
        """Wait until the robot's guard has reported on this link, or the agent that there is none."""

    def end(self, code: ByeCode, detail: str) -> None:
        """Say bye and close; afterwards the registry knows the link no more."""


NO_REPORT = GuardReport()


@dataclass(frozen=True)
class Presence:
    """What is known of one robot now; `since` is the last change of `online`."""

    online: bool = False
    since: datetime | None = None
    # Why the last session of a robot that is offline ended; None: unknown, or it never had one.
    end_code: str | None = None
    # Of the monotonic clock, for durations; None while the robot is offline.
    connected_at: float | None = None
    address: str | None = None
    rtt_ms: float | None = None
    ros: ServiceState = "unknown"
    video: ServiceState = "unknown"
    # Everybody in the robot's own network reaches its rosbridge, past the guard.
    ros_exposed: bool = False
    agent_version: str | None = None
    # The agent's number of its session; 0: it gave none. Of a robot that is offline: of its last one.
    epoch: int = 0
    guard_mode: GuardMode = "unknown"
    report: GuardReport = NO_REPORT
    battery: Battery | None = None

    @property
    def guard(self) -> GuardState | GuardMode:
        """The guard as operators see it: ready, down, off or unknown."""
        return self.report.state if self.guard_mode == "on" else self.guard_mode


NEVER_SEEN = Presence()
# Time after which a robot's position is unknown again; its agent sends a new one each second while somebody uses it.
POSITION_KEPT_S = 5.0


@dataclass(frozen=True)
class Change:
    """What happened to a robot: it connected, disconnected, reported something of itself, or sent a heartbeat.

    `guard_status`: its guard reported; `answers` is the id of the stop or release that it answers. `seen`: its guard
    reported what its driver saw.
    """

    what: Literal["connected", "disconnected", "updated", "heartbeat", "guard_status", "seen"]
    robot_id: int
    presence: Presence
    code: ByeCode | None = None
    answers: str | None = None
    seen: SeenReport | None = None


# Is notified of every change, in order; must not block.
Listener = Callable[[Change], None]


# Time for which the media connection stays open without a viewer: a page that is opened again finds it.
MEDIA_KEPT_S = 300.0
# Time for which heartbeats stay quick without a user: a page that is loaded again changes nothing.
USE_KEPT_S = 10.0
# Maximum rate at which topics are opened, in a second and at once: each costs its rosbridge time, in which that passes
# no drive command.
TOPIC_OPENS_PER_S, TOPIC_OPENS_AT_ONCE = 10.0, 64
# Maximum rate of a robot's calls for help; an agent sends each source once in 5 s at most.
HELP_CALLS_PER_S, HELP_CALLS_AT_ONCE = 1.0, 12


class Robot:
    """One robot. `always_needed`: its ports are published, and anybody may connect to them at any time."""

    def __init__(self, robot_id: int, *, always_needed: bool = False) -> None:
        now = time.monotonic()
        self.id = robot_id
        self.presence = NEVER_SEEN
        # Where it is, and since when, by the monotonic clock, that is known.
        self._position: tuple[Position | None, float] | None = None
        # At most one current link of a kind.
        self.links: dict[Kind, Link] = {}
        self.lease = Lease()
        self.lease_timer: asyncio.TimerHandle | None = None
        # Held while calls over HTTP begin a lease, which all of them then share.
        self.calls_lock = asyncio.Lock()
        self.stops = RobotStops(robot_id)
        # Is called when the lease, the stops or the presence change.
        self.control_watchers: set[Callable[[], None]] = set()
        # Operators' live connections.
        self.connections: set[Connection] = set()
        self.usage = Demand(self._on_usage, kept_s=USE_KEPT_S, always=always_needed)
        # Viewers' need for the media connection, which costs a log-in, memory and heartbeats at both ends.
        self.media_demand = Demand(self._on_media_demand, kept_s=MEDIA_KEPT_S, always=always_needed)
        # Copies of what it sends, by what tells them apart; `shared_copies` keeps them.
        self.feeds: dict[Hashable, object] = {}
        self.topics: dict[Hashable, object] = {}
        self.topic_opens = RateLimiter(now, per_s=TOPIC_OPENS_PER_S, at_once=TOPIC_OPENS_AT_ONCE)
        # What observers at other cells share there; `channels/rosbridge/forwarded_topics` makes them.
        self.forwarded_topics: set[object] = set()
        self.uplink = Uplink()
        self.viewer_stats = ViewerStats()
        self.camera_counts = CameraCounts()
        self.delivered_frames = DeliveredFrames()
        self.recorders = Recorders()
        # Number of signatures of the audit log that it may still send to what it was asked.
        self.expected_heads = 0
        # The records of its session, and of its newest drive: a guard reports later what it refused.
        self.session_entry: SessionEntry | None = None
        self.newest_drive: DriveLog | None = None
        # How far its request for help is, as the database last said.
        self.help_state = "none"
        # What it asked for last, by source: while it waits for the database, a newer call takes its place.
        self.help_entries: dict[HelpSource, HelpEntry] = {}
        self.help_limiter = RateLimiter(now, per_s=HELP_CALLS_PER_S, at_once=HELP_CALLS_AT_ONCE)
        # Counts of the guard's last report; None: it has not reported.
        self.guard_refusals: dict[str, int] | None = None
        # Time for which its guard has slowed commands since this relay began, in seconds.
        self.slowed_s = 0.0
        # Of the loop's clock.
        self.rtt_notified_at = 0.0
        # Of the monotonic clock: when rebalancing sent the robot to another cell.
        self.sent_away_at: float | None = None

    @property
    def session(self) -> Link | None:
        """The session's link of a robot that is online."""
        return self.links.get("session") if self.presence.online else None

    def on_position(self, position: Position | None) -> None:
        """The agent reported where the robot is."""
        self._position = position, time.monotonic()

    def position_now(self) -> Position | None:
        """Return where the robot is, None: unknown."""
        position, at = self._position or (None, 0.0)
        return position if time.monotonic() - at < POSITION_KEPT_S else None

    def current_links(self) -> list[Link]:
        """List the current links, the session first."""
        return [link for kind in get_args(Kind) if (link := self.links.get(kind)) is not None]

    def close(self) -> None:
        """Cancel all timers."""
        if self.lease_timer is not None:
            self.lease_timer.cancel()
        self.stops.close()
        self.usage.close()
        self.media_demand.close()

    def _on_usage(self) -> None:
        for link in self.current_links():
            link.on_usage()

    def _on_media_demand(self) -> None:
        for link in self.current_links():
            link.on_media_demand()
