"""The control of all robots: leases, stops, and the control object that describes them.

`wiring` makes one; `channels/rosbridge`, `control_api` and `fleet_events` use it. Listeners are notified of changes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial

from robotether_server.contract.control import (
    ControlObject,
    DriverObject,
    RequestObject,
    ReservationObject,
    StopObject,
)
from robotether_server.db.control import StoredControl
from robotether_server.db.fleet import RelayRequest, RelayRobot, Snapshot
from robotether_server.relay.control.leasing import Leasing, now
from robotether_server.relay.control.stops import Stops
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.records.database import RelayDatabase
from robotether_server.relay.records.event_writer import EventWriter
from robotether_server.relay.robots.connection import permits
from robotether_server.relay.robots.lease import Driver, Lease, Reservation
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import Change
from robotether_server.times import rfc3339


class Control:
    """Leases and stops, and who is notified of them."""

    def __init__(
        self,
        database: RelayDatabase,
        event_writer: EventWriter,
        registry: SessionRegistry,
        snapshot: Callable[[], Snapshot],
        robots_leave: Callable[[], bool],
    ) -> None:
        self._registry = registry
        self._snapshot = snapshot
        self._robots_leave = robots_leave
        self._listeners: list[Callable[[int], None]] = []
        self.leasing = Leasing(
            database=database,
            event_writer=event_writer,
            registry=registry,
            stopped=self._why_no_lease,
            changed=self._changed,
        )
        self.stops = Stops(
            event_writer=event_writer,
            registry=registry,
            robots=lambda: snapshot().robots,
            revoke=self.leasing.revoke,
            changed=self._changed,
        )

    def listen(self, listener: Callable[[int], None]) -> None:
        """Notify this of each robot whose control changes."""
        self._listeners.append(listener)

    @contextmanager
    def watched(self, robot_id: int, changed: Callable[[], None]) -> Iterator[None]:
        """Notify of changes of one robot's control inside the block."""
        watchers = self._registry.ensure_robot(robot_id).control_watchers
        watchers.add(changed)
        try:
            yield
        finally:
            watchers.discard(changed)

    def remember(self, stored: StoredControl) -> None:
        """Take over what the relay before this one kept, or another cell."""
        self.leasing.remember(stored.fences)
        for stop in stored.stops:
            self.stops.learn(stop, is_written=True)

    def on_snapshot(self, snapshot: Snapshot) -> None:
        """Rights changed."""
        self.leasing.keep_only(partial(_may_drive, snapshot))

    def on_help_requests(self, requests: Sequence[RelayRequest] | None) -> None:
        """The robots' open requests for help were read: their leases are kept for those who were asked.

        None: they are unknown, and what is kept lasts for its time.
        """
        if requests is not None:
            self.leasing.reserve(requests, partial(_may_drive, self._snapshot()))

    def greeting(self, robot_id: int) -> list[bytes]:
        """What a robot is sent after its configuration."""
        return [self.leasing.line(robot_id), *self.stops.greeting(robot_id)]

    def driver(self, robot_id: int) -> str | None:
        """Name who drives the robot."""
        driver = self.leasing.of(robot_id).driver
        return None if driver is None else driver.holder.user

    def describe(self, robot_id: int) -> ControlObject:
        """Build the control object of the contract."""
        lease, timestamp = self.leasing.of(robot_id), now()
        presence = self._registry.presence(robot_id)
        return ControlObject(
            driver=_driver(lease.driver),
            waiting=_waiting(lease),
            reserved=_reserved(lease.reserved(timestamp)),
            stopped=self._stopped(robot_id),
            guard=presence.guard,
            blind_limits=presence.report.blind_limits if presence.guard == "ready" else None,
        )

    def on_robot_change(self, change: Change) -> None:
        """Something happened to a robot; a robot that comes back stopped is stopped here, too."""
        self.stops.on_robot_change(change)
        if change.what not in {"heartbeat", "seen"}:
            self._notify_watchers(change.robot_id)

    def _why_no_lease(self, robot: RelayRobot) -> CloseReason | None:
        if (close_reason := self.stops.close_reason(robot)) is not None:
            return close_reason
        return close_reasons.cell_draining(robot.name) if self._robots_leave() else None

    def _changed(self, robot_id: int) -> None:
        for listener in self._listeners:
            listener(robot_id)
        self._notify_watchers(robot_id)

    def _notify_watchers(self, robot_id: int) -> None:
        for changed in list(self._registry.robot(robot_id).control_watchers):
            changed()

    def _stopped(self, robot_id: int) -> StopObject | None:
        stop = self.stops.shown(robot_id)
        if stop is None:
            return None
        return StopObject(stop.by, stop.at, self.stops.confirmed(robot_id))


def _driver(driver: Driver | None) -> DriverObject | None:
    if driver is None:
        return None
    return DriverObject(driver.holder.user, rfc3339(driver.since.utc), driver.fence)


def _waiting(lease: Lease) -> RequestObject | None:
    request, passes_at = lease.request, lease.passes_at()
    if request is None or passes_at is None:
        return None
    return RequestObject(request.user.name, rfc3339(request.since.utc), rfc3339(passes_at.utc))


def _reserved(reservation: Reservation | None) -> ReservationObject | None:
    if reservation is None:
        return None
    return ReservationObject(reservation.user.name, rfc3339(reservation.until.utc))


def _may_drive(snapshot: Snapshot, user_id: int, robot_id: int) -> bool:
    return permits(snapshot.level(user_id, robot_id), "drive")
