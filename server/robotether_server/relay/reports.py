"""Tells log, journal and metrics of what happens to robots and operators.

`relay` hands it to the registry as a listener and to the handlers as their report. It never waits.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from robotether_server.relay.journal import Journal
from robotether_server.relay.metrics import Metrics
from robotether_server.relay.rosbridge import ConnectionReport
from robotether_server.relay.sessions import Change, utc_now
from robotether_server.store.fleet import AuditEntry, SessionEntry, Snapshot

log = logging.getLogger(__name__)


class Reports:
    """Writes down what happens."""

    def __init__(
        self, journal: Journal, metrics: Metrics, snapshot: Callable[[], Snapshot]
    ) -> None:
        self._journal = journal
        self._metrics = metrics
        self._snapshot = snapshot
        self._sessions: dict[int, SessionEntry] = {}

    def robot(self, change: Change) -> None:
        """Something happened to a robot."""
        if change.what == "came":
            self._robot_came(change)
        elif change.what == "left":
            self._robot_left(change)
        elif change.what == "told":
            self._robot_told(change)

    def session_refused(self, code: str) -> None:
        """A robot's connection was refused."""
        self._metrics.session_refusals.labels(code).inc()

    def port_checked(self, service: str, health: str) -> None:
        """A robot's port was tried."""
        self._metrics.port_checks.labels(service, health).inc()

    def connection(self, report: ConnectionReport) -> None:
        """An operator's connection began or ended."""
        connection, ending = report.connection, report.ending
        what = "began" if ending is None else f"ended after {report.lasted_s:.1f} s: {ending.name}"
        user, robot = connection.user, connection.robot.name
        log.info("robot %s: %s's %s connection %s", robot, user, connection.use, what)
        if ending is not None:
            self._metrics.endings.labels(ending.name).inc()
        # A page that waits for a robot that is offline tries again and again; that is no driving.
        if connection.use == "drive" and connection.reached:
            self._journal.add(_audit_of(report))

    def _robot_came(self, change: Change) -> None:
        presence = change.presence
        log.info("robot %s is online from %s", self._name(change.robot_id), presence.address)
        entry = SessionEntry(
            robot_id=change.robot_id,
            started_at=presence.since or utc_now(),
            address=presence.address or "",
        )
        self._sessions[change.robot_id] = entry
        self._journal.add(entry)

    def _robot_left(self, change: Change) -> None:
        log.info("robot %s is offline: %s", self._name(change.robot_id), change.code)
        self._metrics.session_endings.labels(change.code or "").inc()
        entry = self._sessions.pop(change.robot_id, None)
        if entry is not None:
            entry.ended_at, entry.end_code = change.presence.since, change.code
            self._journal.add(entry)

    def _robot_told(self, change: Change) -> None:
        entry = self._sessions.get(change.robot_id)
        if entry is not None and entry.agent_version != change.presence.agent_version:
            entry.agent_version = change.presence.agent_version
            self._journal.add(entry)

    def _name(self, robot_id: int) -> str:
        robot = self._snapshot().robots.get(robot_id)
        return robot.name if robot is not None else str(robot_id)


def _audit_of(report: ConnectionReport) -> AuditEntry:
    ending = report.ending
    details: dict[str, object] = {}
    if ending is not None:
        details = {"end_code": ending.name, "lasted_s": round(report.lasted_s, 1)}
    return AuditEntry(
        at=utc_now(),
        actor=report.connection.user,
        kind="drive_began" if ending is None else "drive_ended",
        robot=report.connection.robot.name,
        address=report.address,
        details=details,
    )
