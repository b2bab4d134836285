"""The robots that the relay knows: makes and drops each, and notifies listeners of what happens to it.

`robot_link` reports what happens on a robot's connection; `connections`, `fleet_events` and `observers` listen.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace
from datetime import datetime
from typing import Any

from robotether_common.session import Battery, ByeCode, Kind, ServiceState

from robotether_server.db.fleet import RelayRobot, Snapshot
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import ConnectionClosedError
from robotether_server.relay.robots.robot import (
    NEVER_SEEN,
    Change,
    Link,
    Listener,
    Presence,
    Robot,
)
from robotether_server.relay.robots.session_messages import GuardMode, GuardReport, SeenReport
from robotether_server.times import utc_now


class SessionRegistry:
    """All robots, by id. `always_needed`: robots' ports are published, so that anybody may use one at any time."""

    def __init__(
        self,
        clock: Callable[[], datetime] = utc_now,
        monotonic: Callable[[], float] = time.monotonic,
        *,
        always_needed: bool = False,
    ) -> None:
        self._listeners: list[Listener] = []
        self._clock = clock
        self._monotonic = monotonic
        self._always_needed = always_needed
        self._robots: dict[int, Robot] = {}
        self._unknown = Robot(0, always_needed=always_needed)
        self._online = 0

    def listen(self, *listeners: Listener) -> None:
        """Notify these of every change from now on."""
        self._listeners.extend(listeners)

    def robot(self, robot_id: int) -> Robot:
        """Return a robot to read it; of one that is not here nothing is known."""
        return self._robots.get(robot_id, self._unknown)

    def ensure_robot(self, robot_id: int) -> Robot:
        """Return a robot to change it; one that is not here yet is made."""
        robot = self._robots.get(robot_id)
        if robot is None:
            robot = self._robots[robot_id] = Robot(robot_id, always_needed=self._always_needed)
        return robot

    def robots(self) -> Collection[Robot]:
        """Return all robots that are known."""
        return list(self._robots.values())

    def on_snapshot(self, snapshot: Snapshot) -> None:
        """Drop robots that are gone and not connected."""
        for robot_id in self._robots.keys() - snapshot.robots.keys():
            robot = self._robots[robot_id]
            if not robot.links:
                robot.close()
                del self._robots[robot_id]

    def close(self) -> None:
        """Cancel the timers of all robots; the relay stops."""
        for robot in self._robots.values():
            robot.close()

    def presence(self, robot_id: int) -> Presence:
        """Return what is known of a robot's connection."""
        return self.robot(robot_id).presence

    def online_presence(self, robot: RelayRobot) -> Presence:
        """Return what is known of the connection of a robot that is online; raise ConnectionClosedError."""
        presence = self.presence(robot.id)
        if not presence.online:
            raise ConnectionClosedError(
                close_reasons.robot_offline(robot.name, presence.since, utc_now())
            )
        return presence

    def session_of(self, robot_id: int) -> Link | None:
        """Return the link of a robot that is online."""
        return self.robot(robot_id).session

    def seen_elsewhere(self, robot_id: int) -> None:
        """Another cell had the robot until now."""
        robot = self.ensure_robot(robot_id)
        if not robot.presence.online:
            robot.presence = replace(robot.presence, since=self._clock(), end_code=None)

    def count(self, kind: Kind) -> int:
        """Count the current links of a kind."""
        return sum(kind in robot.links for robot in self._robots.values())

    def online(self) -> list[tuple[Robot, float]]:
        """List the robots that are online, and when they connected, by the monotonic clock."""
        return [
            (robot, robot.presence.connected_at)
            for robot in self._robots.values()
            if robot.presence.connected_at is not None
        ]

    def end_links(self, robot_id: int, code: ByeCode, detail: str) -> None:
        """End a robot's connections, its session first."""
        for link in self.robot(robot_id).current_links():
            link.end(code, detail)

    def online_count(self) -> int:
        """Count the robots that are online."""
        return self._online

    def remember(self, last_seen: Iterable[tuple[int, datetime, str | None]]) -> None:
        """Take over from the records since when and why robots are offline."""
        for robot_id, since, end_code in last_seen:
            robot = self.ensure_robot(robot_id)
            if robot.presence == NEVER_SEEN:
                robot.presence = Presence(since=since, end_code=end_code)

    def make_current(self, link: Link) -> Link | None:
        """Make `link` the current one of its kind; return the older, which the caller ends."""
        robot = self.ensure_robot(link.robot_id)
        older = robot.links.get(link.kind)
        if older is not None:
            self._forget(older, "superseded")
        robot.links[link.kind] = link
        return older

    def is_current(self, link: Link) -> bool:
        """Return whether no newer link took over."""
        return self.robot(link.robot_id).links.get(link.kind) is link

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
        self._update(link, agent_version=agent_version, guard_mode=guard_mode, epoch=epoch)

    def on_guard_status(self, link: Link, report: GuardReport, answers: str | None) -> None:
        """The guard reported its state, or answered."""
        if self._is_online(link):
            after = replace(self.presence(link.robot_id), report=report)
            self._notify(Change("guard_status", link.robot_id, after, answers=answers))

    def on_seen(self, link: Link, report: SeenReport) -> None:
        """The guard reported how old is what the driver sees."""
        if self._is_online(link):
            self._notify(Change("seen", link.robot_id, self.presence(link.robot_id), seen=report))

    def on_health(
        self, link: Link, ros: ServiceState, video: ServiceState, *, ros_exposed: bool
    ) -> None:
        """The agent reported whether rosbridge and web_video_server answer, and whom the former answers."""
        self._update(link, ros=ros, video=video, ros_exposed=ros_exposed)

    def on_battery(self, link: Link, battery: Battery | None) -> None:
        """The agent reported how full the robot's battery is."""
        self._update(link, battery=battery)

    def on_heartbeat(self, link: Link, rtt_ms: float) -> None:
        """A heartbeat came back."""
        if self._is_online(link):
            presence = self.presence(link.robot_id)
            after = replace(presence, rtt_ms=round(rtt_ms, 1))
            self._notify(Change("heartbeat", link.robot_id, after))

    def _is_online(self, link: Link) -> bool:
        established = self.presence(link.robot_id).online
        return link.kind == "session" and self.is_current(link) and established

    def _update(self, link: Link, **members: Any) -> None:
        before = self.presence(link.robot_id)
        if self._is_online(link) and (after := replace(before, **members)) != before:
            self._notify(Change("updated", link.robot_id, after))

    def _forget(self, link: Link, code: ByeCode) -> None:
        del self.robot(link.robot_id).links[link.kind]
        before = self.presence(link.robot_id)
        if link.kind == "session" and before.online:
            version, epoch = before.agent_version, before.epoch
            after = Presence(since=self._clock(), end_code=code, agent_version=version, epoch=epoch)
            self._notify(Change("disconnected", link.robot_id, after, code))

    def _notify(self, change: Change) -> None:
        robot = self.ensure_robot(change.robot_id)
        self._online += change.presence.online - robot.presence.online
        robot.presence = change.presence
        for listener in self._listeners:
            listener(change)
