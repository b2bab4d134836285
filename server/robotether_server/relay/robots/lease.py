"""The lease of one robot: who drives, who waits, and for whom it is reserved. Pure.

`leasing` has one `Lease` a robot. At most one connection holds it, and the numbers (`fence`) only grow.
A connection first claims the lease, which keeps everybody else out, and holds it once the number that the
database gave is granted. Whoever loses it is returned to the caller, who ends the connection.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta

from robotether_server.db.fleet import RelayUser
from robotether_server.problems import (
    AlreadyAskedError,
    LeaseFreeError,
    LeaseNotYoursError,
    NobodyAsksError,
    NotPossibleError,
    RobotetherError,
    ThrottledError,
)
from robotether_server.relay.http.timing import RateLimiter
from robotether_server.relay.robots.connection import Connection

PASSES_AFTER_S = 20.0
RESERVED_FOR_S = 10.0
# Difference in the end of a reservation up to which it counts as the same: it is computed anew at each poll.
SAME_END_S = 1.0
# Maximum number of requests in a row by one user for one robot: the driver sees each, and the audit
# log has it.
QUESTIONS_AT_ONCE = 3
QUESTION_EVERY_S = 30.0


def _is_same(holder: Connection, other: Connection) -> bool:
    """Return whether one may drive in place of the other: a route and its maker are two."""
    return (holder.user_id, holder.is_route) == (other.user_id, other.is_route)


@dataclass(frozen=True)
class Instant:
    """One time on two clocks: seconds for durations, and the time for people."""

    s: float
    utc: datetime

    def later(self, seconds: float) -> Instant:
        """Return the time so much later."""
        return Instant(self.s + seconds, self.utc + timedelta(seconds=seconds))


@dataclass
class Driver:
    """Who holds the lease; `input` is when a command came last, `calls` the number of calls over HTTP that share it."""

    holder: Connection
    fence: int
    since: Instant
    input: Instant
    calls: int = 0

    def on_command(self, now: Instant) -> None:
        """The driver sent a command: it is there. A route is not, as it answers nobody who asks for control."""
        if not self.holder.is_route:
            self.input = now


def _is_driven_by(driver: Driver, user: RelayUser) -> bool:
    """Return whether the user drives, and not a route of the user."""
    return driver.holder.user_id == user.id and not driver.holder.is_route


@dataclass(frozen=True)
class ControlRequest:
    """Who asked for control."""

    user: RelayUser
    since: Instant


@dataclass(frozen=True)
class Reservation:
    """For whom alone the lease is kept; `is_to_help`: who was offered the robot's request for help, or accepted it."""

    user: RelayUser
    until: Instant
    is_to_help: bool = False


@dataclass(frozen=True)
class Handover:
    """The control went from a driver, if there was one, to a user that has yet to connect."""

    driver: Driver | None
    to: RelayUser


class HeldError(RobotetherError):
    """Somebody else drives, or the lease is kept for somebody else.

    `is_call`: by a call over HTTP; `is_to_help`: kept for who is to help the robot, and may never come.
    """

    def __init__(
        self, user: str, since: Instant | None, *, is_call: bool = False, is_to_help: bool = False
    ) -> None:
        super().__init__(user)
        self.user = user
        self.since = since
        self.is_call = is_call
        self.is_to_help = is_to_help


class Lease:
    """The control of one robot."""

    def __init__(self) -> None:
        self.fence = 0
        self.driver: Driver | None = None
        self.request: ControlRequest | None = None
        self._reserved: Reservation | None = None
        # Who is about to hold it.
        self.claimant: Connection | None = None
        self._questions: dict[int, RateLimiter] = {}

    def reserved(self, now: Instant) -> Reservation | None:
        """For whom the lease is kept now."""
        reservation = self._reserved
        return reservation if reservation is not None and now.s < reservation.until.s else None

    def reserve(self, user: RelayUser | None, until: Instant, now: Instant) -> bool:
        """Keep a free lease for whoever is to help the robot, None: for nobody; return whether that changes anything.

        A person who drives, is about to, or got control from a driver or by taking it comes first.
        """
        before = self.reserved(now)
        if self.driver is not None or self.claimant is not None:
            return False
        if before is not None and not before.is_to_help:
            return False
        after = None if user is None else Reservation(user, until, is_to_help=True)
        if before is None or after is None:
            self._reserved = after
            return before is not after
        self._reserved = after
        return before.user != user or abs(before.until.s - until.s) > SAME_END_S

    def claim(self, holder: Connection, now: Instant) -> Connection | None:
        """Keep everybody else out until the number is there; return this user's older claimant.

        This user's older connection drives on meanwhile. Raises HeldError.
        """
        present = self.driver.holder if self.driver is not None else self.claimant
        if present is not None and not _is_same(present, holder):
            since = self.driver.since if self.driver is not None else None
            raise HeldError(present.user, since, is_call=present.is_call)
        reservation = self.reserved(now)
        if reservation is not None and (holder.is_route or reservation.user.id != holder.user_id):
            raise HeldError(reservation.user.name, None, is_to_help=reservation.is_to_help)
        older, self.claimant = self.claimant, holder
        return older

    def grant(self, holder: Connection, fence: int, now: Instant) -> Driver | None:
        """Let the claimant drive with this number, in place of its user's older connection.

        None when its claim is gone, or the number is no newer.
        """
        if self.claimant is not holder or fence <= self.fence:
            return None
        self.fence = fence
        self.claimant = self._reserved = None
        self.driver = Driver(holder, fence, now, now)
        return self.driver

    def end(self, holder: Connection, now: Instant) -> Driver | None:
        """A connection is over; return what it held. The person who waits is next."""
        if self.claimant is holder:
            self.claimant = None
        driver = self.driver if self.driver is not None and self.driver.holder is holder else None
        if driver is not None:
            self.driver = None
        if self.driver is None and self.claimant is None and self.request is not None:
            self._keep_for(self.request.user, now)
        return driver

    def revoke(self) -> Connection | None:
        """End everything: the robot is stopped, or gone. Return who drove or was about to."""
        present = self.driver.holder if self.driver is not None else self.claimant
        self.driver = self.claimant = self.request = self._reserved = None
        return present

    def ask(self, user: RelayUser, now: Instant) -> bool:
        """Ask the driver for the control; False when this user asked already. Throttled after a few in a row."""
        driver = self._driver_or_free(now)
        if _is_driven_by(driver, user):
            raise LeaseFreeError("cannot ask for control: it is yours")
        if self.request is not None and self.request.user.id != user.id:
            raise AlreadyAskedError(
                f"cannot ask for control: {self.request.user.name} waits for it"
            )
        if self.request is not None:
            return False
        self._count_question(user, now)
        self.request = ControlRequest(user, now)
        return True

    def withdraw(self, user: RelayUser) -> None:
        """Take one's question back."""
        if self.request is None or self.request.user.id != user.id:
            raise NobodyAsksError("cannot withdraw the request: you have not asked for control")
        self.request = None

    def refuse(self, user: RelayUser, now: Instant) -> RelayUser:
        """The driver says no; return to whom."""
        asker = self._asker_of(user, now)
        self.request = None
        return asker

    def hand_over(self, user: RelayUser, now: Instant, to: str | None = None) -> Handover:
        """The driver says yes, to whoever asks or to the one of this name alone."""
        asker = self._asker_of(user, now)
        if to is not None and asker.name != to:
            raise NobodyAsksError(f"cannot hand control over: {asker.name} asks for it now")
        return self._pass_to(asker, now)

    def take(self, user: RelayUser, now: Instant, driver: str | None = None) -> Handover | None:
        """Give a manager the control at once; None when it has it, or it is kept for it.

        With `driver`, only from the driver of this name: the manager has not seen another one.
        """
        if self._is_for(user, now):
            return None
        if self.driver is None and self.reserved(now) is None:
            self._driver_or_free(now)
        if driver is not None and (self.driver is None or self.driver.holder.user != driver):
            raise NotPossibleError("cannot take control: another user has it now; check again")
        return self._pass_to(user, now)

    def passes_at(self) -> Instant | None:
        """When the control passes on by itself, if no command and no answer comes."""
        if self.driver is None or self.request is None:
            return None
        last = max(self.driver.input, self.request.since, key=lambda timestamp: timestamp.s)
        return last.later(PASSES_AFTER_S)

    def pass_on(self, now: Instant) -> Handover | None:
        """Pass the control on, when that is due."""
        due = self.passes_at()
        if due is None or self.request is None or now.s < due.s:
            return None
        return self._pass_to(self.request.user, now)

    def keep_only(self, may_drive: Callable[[int], bool]) -> bool:
        """Forget who waits, and for whom it is kept, without the right to drive; return whether anybody was."""
        before = (self.request, self._reserved)
        if self.request is not None and not may_drive(self.request.user.id):
            self.request = None
        if self._reserved is not None and not may_drive(self._reserved.user.id):
            self._reserved = None
        return before != (self.request, self._reserved)

    def _is_for(self, user: RelayUser, now: Instant) -> bool:
        if self.driver is not None:
            return _is_driven_by(self.driver, user)
        reservation = self.reserved(now)
        return reservation is not None and reservation.user.id == user.id

    def _count_question(self, user: RelayUser, now: Instant) -> None:
        fresh = RateLimiter(now.s, per_s=1 / QUESTION_EVERY_S, at_once=QUESTIONS_AT_ONCE)
        limiter = self._questions.setdefault(user.id, fresh)
        if not limiter.allow(now.s):
            wait_s = math.ceil(limiter.free_in_s(now.s))
            raise ThrottledError(
                f"cannot ask for control: you have asked {QUESTIONS_AT_ONCE} times in a row; "
                f"ask again in {wait_s} s",
                wait_s,
            )

    def _driver_or_free(self, now: Instant) -> Driver:
        if self.driver is not None:
            return self.driver
        reservation = self.reserved(now)
        if reservation is not None:
            raise AlreadyAskedError(
                f"cannot ask for control: it is reserved for {reservation.user.name}"
            )
        raise LeaseFreeError(
            "cannot change control: nobody has it; connect, after a release if the robot is stopped"
        )

    def _asker_of(self, user: RelayUser, now: Instant) -> RelayUser:
        if self._driver_or_free(now).holder.user_id != user.id:
            raise LeaseNotYoursError("cannot answer for the driver: you do not drive this robot")
        if self.request is None:
            raise NobodyAsksError("cannot answer: nobody asks for control")
        return self.request.user

    def _pass_to(self, user: RelayUser, now: Instant) -> Handover:
        driver, self.driver, self.claimant = self.driver, None, None
        self._keep_for(user, now)
        return Handover(driver, user)

    def _keep_for(self, user: RelayUser, now: Instant) -> None:
        # The person who got it had a reason to ask.
        self._questions.pop(user.id, None)
        self.request, self._reserved = None, Reservation(user, now.later(RESERVED_FOR_S))
