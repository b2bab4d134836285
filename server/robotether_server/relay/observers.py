"""Reports events of robots and operators to log, event writer and metrics.

`wiring` hands it to the registry as a listener and to the handlers as their report. It never waits.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping

from robotether_common.session import HelpCall

from robotether_server.db.control import DriveEntry
from robotether_server.db.fleet import AuditEntry, HelpEntry, SessionEntry, Snapshot
from robotether_server.relay.channels.rosbridge.handler import ConnectionReport
from robotether_server.relay.metrics import Metrics
from robotether_server.relay.records.event_writer import EventWriter
from robotether_server.relay.robots.drive_log import DriveLog
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import Change, Robot
from robotether_server.times import utc_now

log = logging.getLogger(__name__)

# Time after a drive's end in which a guard's report belongs to it: it comes after a second, or when
# the robot is back.
GUARD_REPORTS_WITHIN_S = 10.0


class RelayObserver:
    """Writes down what happens."""

    def __init__(
        self,
        event_writer: EventWriter,
        metrics: Metrics,
        registry: SessionRegistry,
        snapshot: Callable[[], Snapshot],
    ) -> None:
        self._registry = registry
        self._event_writer = event_writer
        self._metrics = metrics
        self._snapshot = snapshot
        self._drives: set[DriveLog] = set()

    def on_robot_change(self, change: Change) -> None:
        """Something happened to a robot."""
        if change.what == "connected":
            self._on_connected(change)
        elif change.what == "disconnected":
            self._on_disconnected(change)
        elif change.what == "updated":
            self._on_updated(change)
        elif change.what == "guard_status":
            self._on_guard_status(change)
        elif change.what == "seen":
            self._on_seen(change)
        elif change.what == "heartbeat" and change.presence.rtt_ms is not None:
            self._metrics.robot_round_trips.add(change.presence.rtt_ms / 1000)

    def help_called(self, robot_id: int, call: HelpCall) -> None:
        """A robot asked for a person; beyond its rate nothing follows."""
        robot, row = self._registry.ensure_robot(robot_id), self._snapshot().robots.get(robot_id)
        if row is None or not robot.help_limiter.allow(time.monotonic()):
            return
        log.info("robot %s asks for help (%s): %s", row.name, call.source, call.reason)
        entry = robot.help_entries.setdefault(
            call.source, HelpEntry(robot_id, call.source, call.reason, call.priority)
        )
        entry.reason, entry.priority = call.reason, call.priority
        entry.pool = row.settings.help.pool or ""
        self._event_writer.add(entry)

    def session_refused(self, code: str) -> None:
        """A robot's connection was refused."""
        self._metrics.session_refusals.labels(code).inc()

    def port_checked(self, service: str, health: str) -> None:
        """A robot's port was tried."""
        self._metrics.port_checks.labels(service, health).inc()

    def connection(self, report: ConnectionReport) -> None:
        """An operator's connection began or ended."""
        connection, close_reason = report.connection, report.close_reason
        what = (
            "began"
            if close_reason is None
            else f"ended after {report.lasted_s:.1f} s: {close_reason.name}"
        )
        user, robot = connection.user, connection.robot.name
        log.info("robot %s: %s's %s connection %s", robot, user, connection.use, what)
        if close_reason is not None:
            self._metrics.close_reasons.labels(close_reason.name).inc()
        # A page that waits for a robot that is offline tries again and again; that is no driving.
        if report.drive is not None:
            self._drive(report, report.drive)
        if close_reason is not None and report.refused:
            self._event_writer.add(_audit(report, "operations_refused", dict(report.refused)))

    async def run(self, every_s: float) -> None:
        """Write the drives that last, for ever."""
        while True:
            await asyncio.sleep(every_s)
            self.write_drives()

    def write_drives(self) -> None:
        """Write the drives that last, so that a relay that is killed loses little of them."""
        for drive in self._drives:
            self._event_writer.add(drive.written())

    def _drive(self, report: ConnectionReport, drive: DriveLog) -> None:
        close_reason = report.close_reason
        if close_reason is None:
            self._drives.add(drive)
            self._registry.ensure_robot(drive.entry.robot_id).newest_drive = drive
            self._event_writer.add(_audit(report, "drive_started", {"fence": drive.entry.fence}))
            self._event_writer.add(drive.written())
            return
        self._drives.discard(drive)
        entry = drive.end(time.monotonic(), utc_now(), close_reason.name)
        self._metrics.dropped_old.inc(entry.dropped_old)
        self._event_writer.add(entry)
        self._event_writer.add(_audit(report, "drive_ended", _summary(entry, report)))

    def _on_connected(self, change: Change) -> None:
        presence = change.presence
        log.info("robot %s is online from %s", self._name(change.robot_id), presence.address)
        entry = SessionEntry(
            robot_id=change.robot_id,
            started_at=presence.since or utc_now(),
            address=presence.address or "",
        )
        self._registry.ensure_robot(change.robot_id).session_entry = entry
        self._event_writer.add(entry)

    def _on_disconnected(self, change: Change) -> None:
        log.info("robot %s is offline: %s", self._name(change.robot_id), change.code)
        self._metrics.session_close_codes.labels(change.code or "").inc()
        robot = self._registry.ensure_robot(change.robot_id)
        entry, robot.session_entry = robot.session_entry, None
        if entry is not None:
            entry.ended_at, entry.end_code = change.presence.since, change.code
            self._event_writer.add(entry)

    def _on_updated(self, change: Change) -> None:
        entry, presence = self._registry.robot(change.robot_id).session_entry, change.presence
        reported = (presence.agent_version, presence.ros_exposed, presence.epoch)
        if entry is None:
            return
        if (entry.agent_version, entry.ros_exposed, entry.epoch) != reported:
            entry.agent_version, entry.ros_exposed, entry.epoch = reported
            self._event_writer.add(entry)

    def _on_guard_status(self, change: Change) -> None:
        robot = self._registry.ensure_robot(change.robot_id)
        more = new_refusals(robot, change.presence.report.refused)
        for kind, count in more.items():
            self._metrics.guard_refusals.labels(kind).inc(count)
        drive = robot.newest_drive
        if not more or drive is None or not _accepts_reports(drive):
            return
        drive.refused_by_guard(more)
        if drive.ended_s is not None:
            self._event_writer.add(drive.written())

    def _on_seen(self, change: Change) -> None:
        if change.seen is None:
            return
        robot = self._registry.ensure_robot(change.robot_id)
        robot.slowed_s += change.seen.slowed_s or 0.0
        self._metrics.count_seen(change.seen.ages_ms)
        drive = robot.newest_drive
        if drive is None or not _accepts_reports(drive):
            return
        drive.on_seen(change.seen)
        if drive.ended_s is not None:
            self._event_writer.add(drive.written())

    def _name(self, robot_id: int) -> str:
        robot = self._snapshot().robots.get(robot_id)
        return robot.name if robot is not None else str(robot_id)


def _accepts_reports(drive: DriveLog) -> bool:
    """Return whether what a guard reports now may belong to the drive."""
    return drive.ended_s is None or time.monotonic() - drive.ended_s <= GUARD_REPORTS_WITHIN_S


def _audit(report: ConnectionReport, kind: str, details: Mapping[str, object]) -> AuditEntry:
    return AuditEntry(
        at=utc_now(),
        actor=report.connection.user,
        kind=kind,
        robot=report.connection.robot.name,
        address=report.address,
        details=details,
    )


def _summary(entry: DriveEntry, report: ConnectionReport) -> dict[str, object]:
    return {
        "end_code": entry.end_code,
        "fence": entry.fence,
        "lasted_s": round(report.lasted_s, 1),
        "distance_m": round(entry.distance_m, 3),
        "top_speed_m_s": round(entry.top_speed_m_s, 3),
    }


def new_refusals(robot: Robot, refused: Iterable[tuple[str, int]]) -> Counter[str]:
    """Return how many more its guard refused since it last reported, by kind; nothing at the first report.

    A guard counts from its own start on.
    """
    reported = dict(refused)
    if not reported:
        return Counter()
    # What it refused before this relay began belongs to nobody that is known.
    before = reported if robot.guard_refusals is None else robot.guard_refusals
    robot.guard_refusals = reported
    if any(reported.get(kind, 0) < count for kind, count in before.items()):
        # Another guard, which began to count again.
        before = {}
    return +Counter({kind: count - before.get(kind, 0) for kind, count in reported.items()})
