"""Which robots are stopped: written to the database, sent to their guards, and ended by a release.

`control_api` and drivers' and observers' own operations stop robots, `wiring` hands it what guards report. A
stop needs no database: it holds in memory at once, its row is written when the database is there. A robot
is stopped when either side says so. The newest stop takes the older one's place, so that a release which
names what its person saw cannot end one unseen. Nothing here ever releases a robot that did not confirm it.

Cells share their stops (`peers`): each keeps the stops of a robot one by one, with the last that ended. So a release
ends those that its cell knew, at all cells, and no other.
"""

from __future__ import annotations

import asyncio
import logging
import math
import secrets
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from robotether_server.contract.control import ShownStop
from robotether_server.db.control import MAX_NAME, Stop, StopEntry, StopId
from robotether_server.db.fleet import AuditEntry, RelayRobot
from robotether_server.problems import GuardSilentError, NotPossibleError
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.records.event_writer import EventWriter
from robotether_server.relay.robots import session_messages as lines
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import Change
from robotether_server.relay.robots.robot_stops import Release, RobotStops
from robotether_server.times import rfc3339, utc_now

log = logging.getLogger(__name__)

MESSAGE_ID_BYTES = 8
CONFIRMED_WITHIN_S = 1.0
RELEASED_WITHIN_S = 2.0
# Interval between repetitions of an unconfirmed stop or release; the guard may have been starting.
REPEAT_EVERY_S = 1.0
INSIST_EVERY_S = 0.2
# Time in which a page's second path repeats one press, which must not hide another person's stop.
# At least the resolution of displayed times, so that two stops of one person never look alike.
SAME_PRESS_S = 1.0
# No name of a user reads like this.
AT_ROBOT = "somebody at the robot"


@dataclass(frozen=True, kw_only=True)
class Stops:
    """The stops of all robots."""

    event_writer: EventWriter
    registry: SessionRegistry
    robots: Callable[[], Mapping[int, RelayRobot]]
    revoke: Callable[[int, CloseReason], None]
    changed: Callable[[int], None]

    def learn(self, stop: Stop, *, is_written: bool = False) -> None:
        """Take over a stop that began at another cell, which may end before it is written, or that the database has."""
        stops = self._of(stop.robot_id)
        if stops.knows(stop.id):
            return
        robot = self.robots().get(stop.robot_id)
        if robot is None:
            # It is not read yet.
            stops.begin(stop)
        else:
            self._fail_releases(robot, stop.by)
            self._begin(robot, stop)
        if not is_written:
            self.event_writer.add(stops.entry)

    def learn_end(self, robot_id: int, stop_id: StopId) -> None:
        """Take over that another cell released the robot from a stop."""
        if stop_id not in self._of(robot_id).ended:
            self._end(robot_id, [stop_id])
            self._watch(robot_id)
            report = self.registry.presence(robot_id).report
            if report.stopped:
                # It has come here since, and was greeted with the stop: without one nobody could release it.
                self._stopped_by_guard(robot_id, report.by)

    def restore(self, entries: Iterable[StopEntry]) -> None:
        """Take over what the relay before this one had not written, before any robot is served.

        In the database alone nobody would stop the robot here, or could release it. As of what another cell says, a
        stop may have ended elsewhere since, which the other cells say then.
        """
        for entry in entries:
            stops = self._of(entry.robot_id)
            stops.end(entry.ended)
            if entry.stop is not None:
                stops.begin(entry.stop)
            self.event_writer.add(stops.entry)

    def of(self, robot_id: int) -> Stop | None:
        """Return the newest stop of a robot, None when it is not stopped."""
        return self.registry.robot(robot_id).stops.newest

    def shown(self, robot_id: int) -> ShownStop | None:
        """Return what people see of a robot's stop."""
        stop = self.of(robot_id)
        return None if stop is None else ShownStop(stop.by, rfc3339(stop.at))

    def close_reason(self, robot: RelayRobot) -> CloseReason | None:
        """Say why nobody drives the robot; None: it is not stopped."""
        stop = self.of(robot.id)
        return None if stop is None else close_reasons.robot_stopped(robot.name, stop.by, stop.at)

    def count(self) -> int:
        """How many robots are stopped."""
        return sum(robot.stops.newest is not None for robot in self.registry.robots())

    def confirmed(self, robot_id: int) -> bool:
        """Return whether the robot's guard has the stop."""
        presence = self.registry.presence(robot_id)
        return presence.online and presence.guard_mode == "on" and presence.report.stopped

    def greeting(self, robot_id: int) -> list[bytes]:
        """What a robot is sent when it connects."""
        stop = self.of(robot_id)
        return [] if stop is None else [lines.stop_line(_message_id(), stop.by)]

    def stop(
        self,
        robot: RelayRobot,
        by: str,
        *,
        reason: str | None = None,
        address: str | None = None,
        press: str | None = None,
    ) -> None:
        """Stop the robot, also when it is stopped already or offline.

        A `press` of this person that has come before is no other stop, also if its stop has ended since.
        """
        is_late = press is not None and not self._of(robot.id).is_new_press(by, press)
        is_same = self._same_press(robot.id, by, reason) and not self._pending_releases(robot.id)
        if is_late or is_same:
            self._insist(robot.id)
            return
        self._fail_releases(robot, by)
        self._begin_here(robot, by, reason)
        self._of(robot.id).pressed_at[by] = asyncio.get_running_loop().time()
        details: dict[str, object] = {} if reason is None else {"reason": reason}
        self._audit("robot_stopped", robot, by, address, details)

    async def confirmation(self, robot_id: int) -> bool:
        """Wait shortly until the robot's guard has the stop; return whether it does."""
        presence = self.registry.presence(robot_id)
        if self.confirmed(robot_id) or not presence.online or presence.guard_mode != "on":
            return self.confirmed(robot_id)
        return await self.reported_confirmation(robot_id) or self.confirmed(robot_id)

    async def reported_confirmation(self, robot_id: int) -> bool:
        """Wait shortly until the robot's guard, or the cell that has it, confirms the stop; return whether it does."""
        confirmation = asyncio.get_running_loop().create_future()
        waiters = self._of(robot_id).confirmations
        waiters.append(confirmation)
        try:
            async with asyncio.timeout(CONFIRMED_WITHIN_S):
                await confirmation
        except TimeoutError:
            return False
        finally:
            waiters.remove(confirmation)
        return True

    def on_confirmed(self, robot_id: int) -> None:
        """The robot's guard has the stop, here or at another cell."""
        for confirmation in self.registry.robot(robot_id).stops.confirmations:
            if not confirmation.done():
                confirmation.set_result(None)

    async def release(
        self,
        robot: RelayRobot,
        by: str,
        *,
        seen: ShownStop | None = None,
        address: str | None = None,
    ) -> None:
        """Release the robot; ConnectionClosedError (it is offline) or GuardSilentError when it does not confirm.

        NotPossibleError when another stop is in force than the one that was `seen`.
        """
        self._check_seen(robot, seen)
        presence, stops = self.registry.presence(robot.id), self._of(robot.id)
        if not stops.in_force and not presence.report.stopped:
            return
        self.registry.online_presence(robot)
        release = Release(robot, by, address, tuple(stops.in_force))
        # Without a guard nobody confirms, and the stop was never more than the server's.
        if presence.guard_mode == "on":
            await self._released_by_guard(release)
        else:
            self._end_by(release)
        if (stop := self.of(robot.id)) is not None:
            # It came between the guard's answer and this line.
            raise _stopped_again(robot, stop.by)

    def on_robot_change(self, change: Change) -> None:
        """Something happened to a robot."""
        if change.what == "guard_status":
            self._on_guard_status(change)
        if change.what in {"guard_status", "updated"}:
            self._watch(change.robot_id)

    def _same_press(self, robot_id: int, by: str, reason: str | None) -> bool:
        """Return whether the robot is stopped by what this person did; another reason makes another stop."""
        stop = self.of(robot_id)
        if stop is None or reason not in {None, stop.reason}:
            return False
        # At another cell it may have ended since, which must hear of a new one even if this one hears nothing of it.
        if stop.by == by and self.registry.presence(robot_id).online:
            return True
        pressed_at = self._of(robot_id).pressed_at.get(by, -math.inf)
        return asyncio.get_running_loop().time() - pressed_at < SAME_PRESS_S

    def _check_seen(self, robot: RelayRobot, seen: ShownStop | None) -> None:
        stop = self.of(robot.id)
        if seen is not None and stop is not None and self.shown(robot.id) != seen:
            sentence = close_reasons.stopped_sentence(robot.name, stop.by, stop.at)
            raise NotPossibleError(f"{sentence} too; check again before you release it")

    def _of(self, robot_id: int) -> RobotStops:
        return self.registry.ensure_robot(robot_id).stops

    def _pending_releases(self, robot_id: int) -> list[Release]:
        """Return the releases that wait for the guard."""
        releases = self._of(robot_id).releases.values()
        return [release for release in releases if not release.answer.done()]

    def _fail_releases(self, robot: RelayRobot, by: str) -> None:
        for release in self._pending_releases(robot.id):
            release.answer.set_exception(_stopped_again(robot, by))

    def _begin_here(self, robot: RelayRobot, by: str, reason: str | None = None) -> None:
        self._begin(robot, Stop(robot.id, utc_now(), by, reason))
        self.event_writer.add(self._of(robot.id).entry)

    def _begin(self, robot: RelayRobot, stop: Stop) -> None:
        self._of(robot.id).begin(stop)
        # The robot first: nothing may come before this line.
        self._send_stop(robot.id, stop)
        self.revoke(robot.id, close_reasons.robot_stopped(robot.name, stop.by, stop.at))
        self.changed(robot.id)
        log.warning("robot %s: %s stopped it", robot.name, stop.by)

    def _end(self, robot_id: int, stop_ids: Iterable[StopId]) -> None:
        stops = self._of(robot_id)
        stops.end(stop_ids)
        if stops.entry.stop is None:
            stops.pressed_at.clear()
        self.event_writer.add(stops.entry)
        self.changed(robot_id)

    def _end_by(self, release: Release) -> None:
        self._end(release.robot.id, release.stop_ids)
        self._audit("robot_released", release.robot, release.by, release.address, {})

    def _send_stop(self, robot_id: int, stop: Stop) -> None:
        link = self.registry.session_of(robot_id)
        if link is not None:
            link.send(lines.stop_line(_message_id(), stop.by))
            self._of(robot_id).sent_at = asyncio.get_running_loop().time()
            self._watch(robot_id)

    def _watch(self, robot_id: int) -> None:
        """Look later whether the guard has the stop."""
        presence, stops = self.registry.presence(robot_id), self._of(robot_id)
        is_unconfirmed = (
            presence.online and presence.guard_mode == "on" and not presence.report.stopped
        )
        if is_unconfirmed and stops.newest is not None and stops.repeat_timer is None:
            loop = asyncio.get_running_loop()
            stops.repeat_timer = loop.call_later(REPEAT_EVERY_S, self._repeat, robot_id)

    def _insist(self, robot_id: int) -> None:
        """Somebody stops the robot once more: send that, but a client that never ceases must not fill its session."""
        now = asyncio.get_running_loop().time()
        if now - self._of(robot_id).sent_at >= INSIST_EVERY_S:
            self._repeat(robot_id)

    def _repeat(self, robot_id: int) -> None:
        """Send the stop again, unless its guard has it or is being asked to release the robot."""
        stops = self._of(robot_id)
        stops.close()
        if stops.newest is not None and not self.confirmed(robot_id) and not stops.releases:
            self._send_stop(robot_id, stops.newest)

    async def _released_by_guard(self, release: Release) -> None:
        robot, message_id = release.robot, _message_id()
        link = self.registry.session_of(robot.id)
        releases = self._of(robot.id).releases
        releases[message_id] = release
        try:
            if link is not None:
                link.send(lines.release_line(message_id, release.by))
            async with asyncio.timeout(RELEASED_WITHIN_S):
                await release.answer
        except TimeoutError as exc:
            # The answer alone may be lost: both sides must say the same again.
            if (stop := self.of(robot.id)) is not None:
                self._send_stop(robot.id, stop)
            raise GuardSilentError(
                f"cannot release robot {robot.name}: its guard did not confirm it in "
                f"{RELEASED_WITHIN_S:g} s; it stays stopped"
            ) from exc
        finally:
            del releases[message_id]
            # Meanwhile the stop was not repeated; and whoever asked may be gone.
            self._watch(robot.id)

    def _on_guard_status(self, change: Change) -> None:
        report, robot_id = change.presence.report, change.robot_id
        if report.stopped:
            self._stopped_by_guard(robot_id, report.by)
            return
        release = self._of(robot_id).releases.get(change.answers or "")
        if release is not None and not release.answer.done():
            # In one step: nobody may read that the robot is stopped and its guard does not have it.
            self._end_by(release)
            release.answer.set_result(None)

    def _stopped_by_guard(self, robot_id: int, by: str) -> None:
        self.on_confirmed(robot_id)
        robot = self.robots().get(robot_id)
        if self.of(robot_id) is None and robot is not None:
            name = _claimed_name(by)
            self._begin_here(robot, name)
            self._audit("robot_stopped", robot, name, None, {"told_by": "robot"})

    def _audit(
        self,
        kind: str,
        robot: RelayRobot,
        by: str,
        address: str | None,
        details: Mapping[str, object],
    ) -> None:
        self.event_writer.add(AuditEntry(utc_now(), by, kind, robot.name, address, details))


def _stopped_again(robot: RelayRobot, by: str) -> NotPossibleError:
    return NotPossibleError(f"cannot release robot {robot.name}: {by} has stopped it again")


def _claimed_name(by: str) -> str:
    """Name who stopped a robot by its own word alone, which must not read like what was checked here."""
    if not by or by.startswith(AT_ROBOT):
        return by or AT_ROBOT
    return f"{AT_ROBOT} ({by[: MAX_NAME - len(AT_ROBOT) - len(' ()')]})"


def _message_id() -> str:
    return secrets.token_hex(MESSAGE_ID_BYTES)
