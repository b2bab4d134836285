"""Which robots are connected, and what is known of them; in memory.

`robot_link` reports here what happens on a robot's connection; `connections`, `fleet_events` and `observers`
listen. At most one link of a kind is current for a robot.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from typing import Literal, Protocol, get_args

from robotether_common.session import Battery, ByeCode, GuardState, Kind, ServiceState

from robotether_server.db.cells import SshAddresses
from robotether_server.relay.http.timing import RobotClock

# What the agent does in front of rosbridge; unknown until it has said so.
GuardMode = Literal["on", "off", "unknown"]


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


@dataclass(frozen=True)
class GuardReport:
    """What a robot's guard last reported of itself.

    `refused` counts drive commands by kind since its start, `fence` is the newest number of a lease that it knows.
    """

    state: GuardState = "down"
    stopped: bool = False
    by: str = ""
    moving: bool = False
    refused: tuple[tuple[str, int], ...] = ()
    fence: int = 0


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


@dataclass(frozen=True)
class Change:
    """What happened to a robot: it connected, disconnected, reported something of itself, or sent a heartbeat.

    `guard_status`: its guard reported; `answers` is the id of the stop or release that it answers.
    """

    what: Literal["connected", "disconnected", "updated", "heartbeat", "guard_status"]
    robot_id: int
    presence: Presence
    code: ByeCode | None = None
    answers: str | None = None


# Is notified of every change, in order; must not block.
Listener = Callable[[Change], None]


def utc_now() -> datetime:
    """Return the time for people; durations are measured with a monotonic clock."""
    return datetime.now(timezone.utc)


class SessionRegistry:
    """The current links and the presence of each robot."""

    def __init__(
        self,
        clock: Callable[[], datetime] = utc_now,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._listeners: list[Listener] = []
        self._clock = clock
        self._monotonic = monotonic
        self._current: dict[tuple[int, Kind], Link] = {}
        self._presences: dict[int, Presence] = {}
        self._online = 0

    def listen(self, *listeners: Listener) -> None:
        """Notify these of every change from now on."""
        self._listeners.extend(listeners)

    def presence(self, robot_id: int) -> Presence:
        """Return what is known of a robot."""
        return self._presences.get(robot_id, NEVER_SEEN)

    def session_of(self, robot_id: int) -> Link | None:
        """Return the link of a robot that is online."""
        return self._current.get((robot_id, "session")) if self.presence(robot_id).online else None

    def on_media_demand(self, robot_id: int) -> None:
        """Viewers of the robot's video came, or the last one left a while ago."""
        for link in self._links_of(robot_id):
            link.on_media_demand()

    def on_usage(self, robot_id: int) -> None:
        """Somebody is about to use the robot, or the last one left a while ago."""
        for link in self._links_of(robot_id):
            link.on_usage()

    def seen_elsewhere(self, robot_id: int) -> None:
        """Another cell had the robot until now."""
        presence = self.presence(robot_id)
        if not presence.online:
            self._presences[robot_id] = replace(presence, since=self._clock(), end_code=None)

    def has(self, robot_id: int, kind: Kind) -> bool:
        """Return whether a robot has a link of a kind."""
        return (robot_id, kind) in self._current

    def count(self, kind: Kind) -> int:
        """Count the current links of a kind."""
        return sum(each == kind for _, each in self._current)

    def online(self) -> list[tuple[int, float]]:
        """List the robots that are online, and when they connected, by the monotonic clock."""
        return [
            (robot_id, presence.connected_at)
            for robot_id, presence in self._presences.items()
            if presence.connected_at is not None
        ]

    def end_links(self, robot_id: int, code: ByeCode, detail: str) -> None:
        """End a robot's connections, its session first."""
        for link in self._links_of(robot_id):
            link.end(code, detail)

    def online_count(self) -> int:
        """Count the robots that are online."""
        return self._online

    def remember(self, last_seen: Iterable[tuple[int, datetime, str | None]]) -> None:
        """Take over from the records since when and why robots are offline."""
        for robot_id, since, end_code in last_seen:
            if robot_id not in self._presences:
                self._presences[robot_id] = Presence(since=since, end_code=end_code)

    def forget_all_but(self, robot_ids: Iterable[int]) -> None:
        """Drop what is known of robots that are gone and not connected."""
        keep = set(robot_ids) | {robot_id for robot_id, _ in self._current}
        for robot_id in self._presences.keys() - keep:
            del self._presences[robot_id]

    def make_current(self, link: Link) -> Link | None:
        """Make `link` the current one of its kind; return the older, which the caller ends."""
        key = (link.robot_id, link.kind)
        older = self._current.get(key)
        if older is not None:
            self._forget(older, "superseded")
        self._current[key] = link
        return older

    def is_current(self, link: Link) -> bool:
        """Return whether no newer link took over."""
        return self._current.get((link.robot_id, link.kind)) is link

    def established(self, link: Link) -> None:
        """The link has its configuration; a robot with an established session is online."""
        if link.kind == "session" and self.is_current(link):
            presence = Presence(
                online=True,
                since=self._clock(),
                connected_at=self._monotonic(),
                address=link.address,
            )
            self._notify(Change("connected", link.robot_id, presence))

    def disconnected(self, link: Link, code: ByeCode) -> None:
        """The link ended; does nothing when a newer one took over."""
        if self.is_current(link):
            self._forget(link, code)

    def on_hello(
        self, link: Link, agent_version: str, guard_mode: GuardMode, *, epoch: int = 0
    ) -> None:
        """The agent reported its version, whether it has a guard, and its session's number."""
        if self._is_online(link):
            presence = self.presence(link.robot_id)
            after = replace(
                presence, agent_version=agent_version, guard_mode=guard_mode, epoch=epoch
            )
            self._update(link, after)

    def on_guard_status(self, link: Link, report: GuardReport, answers: str | None) -> None:
        """The guard reported its state, or answered."""
        if self._is_online(link):
            after = replace(self.presence(link.robot_id), report=report)
            self._notify(Change("guard_status", link.robot_id, after, answers=answers))

    def on_health(
        self, link: Link, ros: ServiceState, video: ServiceState, *, ros_exposed: bool
    ) -> None:
        """The agent reported whether rosbridge and web_video_server answer, and whom the former answers."""
        if self._is_online(link):
            before = self.presence(link.robot_id)
            self._update(link, replace(before, ros=ros, video=video, ros_exposed=ros_exposed))

    def on_battery(self, link: Link, battery: Battery | None) -> None:
        """The agent reported how full the robot's battery is."""
        if self._is_online(link):
            self._update(link, replace(self.presence(link.robot_id), battery=battery))

    def on_heartbeat(self, link: Link, rtt_ms: float) -> None:
        """A heartbeat came back."""
        if self._is_online(link):
            presence = self.presence(link.robot_id)
            after = replace(presence, rtt_ms=round(rtt_ms, 1))
            self._notify(Change("heartbeat", link.robot_id, after))

    def _links_of(self, robot_id: int) -> list[Link]:
        return [link for kind in get_args(Kind) if (link := self._current.get((robot_id, kind)))]

    def _is_online(self, link: Link) -> bool:
        established = self.presence(link.robot_id).online
        return link.kind == "session" and self.is_current(link) and established

    def _update(self, link: Link, presence: Presence) -> None:
        if presence != self.presence(link.robot_id):
            self._notify(Change("updated", link.robot_id, presence))

    def _forget(self, link: Link, code: ByeCode) -> None:
        del self._current[link.robot_id, link.kind]
        before = self.presence(link.robot_id)
        if link.kind == "session" and before.online:
            version, epoch = before.agent_version, before.epoch
            after = Presence(since=self._clock(), end_code=code, agent_version=version, epoch=epoch)
            self._notify(Change("disconnected", link.robot_id, after, code))

    def _notify(self, change: Change) -> None:
        self._online += change.presence.online - self.presence(change.robot_id).online
        self._presences[change.robot_id] = change.presence
        for listener in self._listeners:
            listener(change)
