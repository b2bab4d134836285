"""Grants and ends leases, with numbers from the database, lines to robots, and timers.

`rosbridge` begins and ends leases, `control_api` does what people ask for, `stops` ends them. A lease is
granted only after its number is committed, or while the database is away if the robot's guard has reported the
newest one, which is enough to go on from. It is over for everybody at once: the robot is notified before the
connection is closed. The rules themselves are in `robots/lease`.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass

from robotether_server.db.control import LeaseEnd, LeaseStart, NewLease
from robotether_server.db.fleet import AuditEntry, RelayRequest, RelayRobot, RelayUser
from robotether_server.problems import RecordMissingError, RecordRefusedError, StoreError
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason, ConnectionClosedError
from robotether_server.relay.records.database import RelayDatabase
from robotether_server.relay.records.event_writer import EventWriter
from robotether_server.relay.robots import session_messages as lines
from robotether_server.relay.robots.connection import Connection
from robotether_server.relay.robots.lease import (
    Driver,
    Handover,
    HeldError,
    Instant,
    Lease,
)
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.times import utc_now

log = logging.getLogger(__name__)

# Time limit for a guard's first report, which follows the session's first lines unless the guard
# starts.
GUARD_REPORTS_WITHIN_S = 1.0
# Maximum time for which a robot is kept for who is to help it (sql/0025_requests.sql), and some for clocks that differ.
MAX_HELP_RESERVATION_S = 31.0


@dataclass(frozen=True)
class LeaseRequester:
    """Who asks for a change of control, and from where."""

    user: RelayUser
    address: str | None = None


@dataclass(frozen=True, kw_only=True)
class Leasing:
    """The leases of all robots."""

    database: RelayDatabase
    event_writer: EventWriter
    registry: SessionRegistry
    stopped: Callable[[RelayRobot], CloseReason | None]
    changed: Callable[[int], None]

    def of(self, robot_id: int) -> Lease:
        """Return a robot's lease, to read it or to change one that somebody has or claims."""
        return self.registry.robot(robot_id).lease

    def count(self) -> int:
        """How many robots are driven."""
        return sum(robot.lease.driver is not None for robot in self.registry.robots())

    def remember(self, fences: Mapping[int, int]) -> None:
        """Go on from the numbers of the relay before this one."""
        for robot_id, fence in fences.items():
            lease = self.registry.ensure_robot(robot_id).lease
            lease.fence = max(lease.fence, fence)

    def line(self, robot_id: int) -> bytes:
        """Build what a robot is sent of its lease."""
        lease = self.of(robot_id)
        return lines.lease_line(lease.fence, held=lease.driver is not None)

    async def begin(self, connection: Connection) -> Driver:
        """Let the connection drive; raise ConnectionClosedError when it may not."""
        robot = connection.robot
        if (close_reason := self.stopped(robot)) is not None:
            raise ConnectionClosedError(close_reason)
        lease = self.registry.ensure_robot(robot.id).lease
        self._claim(lease, connection)
        recorded = await self._next_fence(connection)
        fence = self._newest_fence(robot.id) + 1 if recorded is None else recorded
        older = lease.driver
        if (driver := lease.grant(connection, fence, now())) is None:
            if recorded is not None:
                # With its number the lease began in the database.
                self._write_end(robot.id, recorded)
            raise ConnectionClosedError(self._why_not(lease, robot))
        if recorded is None:
            self._write_start(robot.id, driver)
        if older is not None:
            older.holder.end(close_reasons.superseded(robot.name))
        self._notify(robot.id)
        return driver

    @asynccontextmanager
    async def shared(self, connection: Connection) -> AsyncIterator[int]:
        """Let a call over HTTP do inside the block what a driver may, and yield the number under which it does.

        That is the number of its user's drive, or of a lease that such calls begin and share. Raises
        ConnectionClosedError as `begin` does.
        """
        robot = self.registry.ensure_robot(connection.robot.id)
        async with robot.calls_lock:
            driver = robot.lease.driver
            is_own = driver is not None and driver.holder.user_id == connection.user_id
            if driver is None or not is_own or driver.holder.is_route:
                driver = await self._begin_for_calls(connection, robot.lease.claimant)
            driver.calls += 1
        try:
            yield driver.fence
        finally:
            driver.calls -= 1
            if driver.holder.is_call and not driver.calls:
                self.end(driver.holder)
                self._audit_calls("calls_ended", driver)

    async def _begin_for_calls(self, connection: Connection, claimant: Connection | None) -> Driver:
        # A page of the same user that is about to drive must not lose that to a call.
        if claimant is not None and claimant.user_id == connection.user_id:
            raise ConnectionClosedError(close_reasons.superseded(connection.robot.name))
        try:
            driver = await self.begin(connection)
        except BaseException:
            self.end(connection)
            raise
        self._audit_calls("calls_started", driver)
        return driver

    def _audit_calls(self, kind: str, driver: Driver) -> None:
        """Note who has control for calls, which are no drive."""
        holder, details = driver.holder, {"fence": driver.fence}
        self.event_writer.add(
            AuditEntry(utc_now(), holder.user, kind, holder.robot.name, None, details)
        )

    def why_lost(self, connection: Connection) -> CloseReason:
        """Say why a call may not drive any more, whose lease is over."""
        robot = connection.robot
        if (close_reason := self.stopped(robot)) is not None:
            return close_reason
        lease = self.of(robot.id)
        if lease.driver is not None:
            to = lease.driver.holder.user
        elif (reservation := lease.reserved(now())) is not None:
            to = reservation.user.name
        else:
            return close_reasons.lease_ended(robot.name)
        if to == connection.user:
            return close_reasons.superseded(robot.name)
        return close_reasons.lease_lost(robot.name, to)

    def end(self, connection: Connection) -> None:
        """The connection is over, and so is its lease."""
        robot_id = connection.robot.id
        lease = self.of(robot_id)
        request, driver = lease.request, lease.end(connection, now())
        if driver is not None:
            self._write_end(robot_id, driver.fence)
        if driver is not None or lease.request is not request:
            self._notify(robot_id)

    def revoke(self, robot_id: int, close_reason: CloseReason) -> None:
        """End whatever there is: the robot is stopped."""
        lease = self.of(robot_id)
        driver, holder = lease.driver, lease.revoke()
        if driver is not None:
            self._write_end(robot_id, driver.fence)
        self._notify(robot_id)
        if holder is not None:
            holder.end(close_reason)

    def keep_only(self, may_drive: Callable[[int, int], bool]) -> None:
        """Forget who waits without the right to drive (user, robot) any more."""
        for robot in self.registry.robots():
            if robot.lease.keep_only(_of_robot(may_drive, robot.id)):
                self._notify(robot.id)

    def reserve(
        self, requests: Iterable[RelayRequest], may_drive: Callable[[int, int], bool]
    ) -> None:
        """Keep free leases for those who are to help robots and may drive (user, robot), and end other such.

        Not for longer than that may be: the database's clock may have been set back.
        """
        timestamp = now()
        users = {
            request.robot_id: (request.user, request.left_s)
            for request in requests
            if request.user is not None
            and request.left_s is not None
            and 0 < request.left_s <= MAX_HELP_RESERVATION_S
        }
        for robot in self.registry.robots():
            user, left_s = users.get(robot.id, (None, 0.0))
            if user is not None and not may_drive(user.id, robot.id):
                user = None
            if robot.lease.reserve(user, timestamp.later(left_s), timestamp):
                self._notify(robot.id)

    def ask(self, robot: RelayRobot, asker: LeaseRequester) -> None:
        """Ask the driver for the control."""
        if self.of(robot.id).ask(asker.user, now()):
            self._audit("lease_asked", robot, asker)
            self._notify(robot.id)

    def withdraw(self, robot: RelayRobot, asker: LeaseRequester) -> None:
        """Take a question back."""
        self.of(robot.id).withdraw(asker.user)
        self._notify(robot.id)

    def refuse(self, robot: RelayRobot, asker: LeaseRequester) -> None:
        """The driver says no."""
        to = self.of(robot.id).refuse(asker.user, now())
        self._audit("lease_refused", robot, asker, to=to.name)
        self._notify(robot.id)

    def hand_over(self, robot: RelayRobot, asker: LeaseRequester, to: str | None = None) -> None:
        """The driver says yes, to whoever asks or to the one of this name alone."""
        change = self.of(robot.id).hand_over(asker.user, now(), to)
        self._audit("lease_handed_over", robot, asker, to=change.to.name)
        self._pass(robot.id, change)

    def take(self, robot: RelayRobot, asker: LeaseRequester, driver: str | None = None) -> None:
        """Give a manager the control, from whoever has it or from the driver of this name alone."""
        change = self.of(robot.id).take(asker.user, now(), driver)
        if change is not None:
            former = None if change.driver is None else change.driver.holder.user
            self._audit("lease_taken", robot, asker, driver=former)
            self._pass(robot.id, change)

    def _claim(self, lease: Lease, connection: Connection) -> None:
        robot = connection.robot
        try:
            older = lease.claim(connection, now())
        except HeldError as held:
            # A route ends for good when somebody else drives. A call is over in a moment, and an offer to help may be.
            if held.is_call and connection.is_route:
                raise ConnectionClosedError(close_reasons.called(robot.name, held.user)) from held
            if held.is_to_help and connection.is_route:
                raise ConnectionClosedError(
                    close_reasons.reserved_to_help(robot.name, held.user)
                ) from held
            since = None if held.since is None else held.since.utc
            raise ConnectionClosedError(
                close_reasons.lease_held(robot.name, held.user, since)
            ) from held
        if older is not None:
            older.end(close_reasons.superseded(robot.name))

    def _why_not(self, lease: Lease, robot: RelayRobot) -> CloseReason:
        """Say why a claim was lost."""
        if (close_reason := self.stopped(robot)) is not None:
            return close_reason
        reservation = lease.reserved(now())
        if reservation is not None:
            return close_reasons.lease_held(robot.name, reservation.user.name, None)
        return close_reasons.lease_unavailable(robot.name)

    async def _next_fence(self, connection: Connection) -> int | None:
        """Have the database number a lease; None: it is away, and the robot's guard knows enough."""
        robot = connection.robot
        await self._until_guard_reported(robot.id)
        above = self._newest_fence(robot.id)
        lease = NewLease(robot.id, connection.user_id, connection.user, utc_now(), above)
        try:
            return await self.database.next_fence(lease)
        except (RecordMissingError, RecordRefusedError) as gone:
            # Robot or user was removed meanwhile, which the relay reads of only in its next look.
            log.info("robot %s: cannot number a drive: %s", robot.name, gone.detail)
            raise ConnectionClosedError(close_reasons.rights_ended(robot.name)) from gone
        except StoreError as problem:
            log.warning("robot %s: cannot number a drive: %s", robot.name, problem.detail)
            if self.registry.presence(robot.id).guard == "ready":
                return None
            raise ConnectionClosedError(close_reasons.lease_unavailable(robot.name)) from problem

    async def _until_guard_reported(self, robot_id: int) -> None:
        link = self.registry.session_of(robot_id)
        if link is not None:
            with suppress(TimeoutError):
                async with asyncio.timeout(GUARD_REPORTS_WITHIN_S):
                    await link.until_guard_reported()

    def _newest_fence(self, robot_id: int) -> int:
        """Return the newest number that is known here; the guard's may be another relay's, or a lost database's."""
        return max(self.of(robot_id).fence, self.registry.presence(robot_id).report.fence)

    def _pass(self, robot_id: int, change: Handover) -> None:
        if change.driver is not None:
            self._write_end(robot_id, change.driver.fence)
        self._notify(robot_id)
        if change.driver is not None:
            connection = change.driver.holder
            connection.end(close_reasons.lease_lost(connection.robot.name, change.to.name))

    def _write_start(self, robot_id: int, driver: Driver) -> None:
        user_id, user = driver.holder.user_id, driver.holder.user
        self.event_writer.add(LeaseStart(robot_id, driver.fence, user_id, user, driver.since.utc))

    def _write_end(self, robot_id: int, fence: int) -> None:
        self.event_writer.add(LeaseEnd(robot_id, fence, utc_now()))

    def audit_call(self, connection: Connection, service: str, address: str | None) -> None:
        """Note a call over HTTP of what only drivers may call."""
        caller = LeaseRequester(RelayUser(connection.user_id, connection.user), address)
        self._audit("service_called", connection.robot, caller, service=service)

    def _audit(
        self, kind: str, robot: RelayRobot, asker: LeaseRequester, **details: str | None
    ) -> None:
        self.event_writer.add(
            AuditEntry(utc_now(), asker.user.name, kind, robot.name, asker.address, details)
        )

    def _notify(self, robot_id: int) -> None:
        """Notify the robot and whoever watches, and check again when time changes something."""
        link = self.registry.session_of(robot_id)
        if link is not None:
            link.send(self.line(robot_id))
        self._arm(robot_id)
        self.changed(robot_id)

    def _arm(self, robot_id: int) -> None:
        self._disarm(robot_id)
        due = min(self._due_at(robot_id), default=None)
        if due is not None:
            loop = asyncio.get_running_loop()
            robot = self.registry.ensure_robot(robot_id)
            robot.lease_timer = loop.call_at(due, self._on_timer, robot_id)

    def _due_at(self, robot_id: int) -> Iterator[float]:
        lease = self.of(robot_id)
        passes_at, reservation = lease.passes_at(), lease.reserved(now())
        if passes_at is not None:
            # At least every second: the person who waits sees that the driver's input put it off.
            yield min(passes_at.s, now().s + 1)
        if reservation is not None:
            yield reservation.until.s

    def _disarm(self, robot_id: int) -> None:
        robot = self.registry.robot(robot_id)
        if robot.lease_timer is not None:
            robot.lease_timer.cancel()
            robot.lease_timer = None

    def _on_timer(self, robot_id: int) -> None:
        lease = self.of(robot_id)
        change = lease.pass_on(now())
        if change is None:
            self._arm(robot_id)
            self.changed(robot_id)
            return
        if change.driver is not None:
            robot, driver = change.driver.holder.robot, change.driver.holder.user
            self._audit("lease_passed", robot, LeaseRequester(change.to), driver=driver)
        self._pass(robot_id, change)


def now() -> Instant:
    """Return the present time; the loop's clock is that of the timers."""
    return Instant(asyncio.get_running_loop().time(), utc_now())


def _of_robot(may_drive: Callable[[int, int], bool], robot_id: int) -> Callable[[int], bool]:
    return lambda user_id: may_drive(user_id, robot_id)
