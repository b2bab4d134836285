"""What happens, as log, event writer and metrics learn it; without a network."""

import logging
from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from relay_server import utc
from robotether_common.session import HelpCall
from robotether_server.db.control import DriveEntry
from robotether_server.db.fleet import AuditEntry, HelpEntry, SessionEntry, Snapshot
from robotether_server.relay.channels.rosbridge.bridge import Traffic
from robotether_server.relay.channels.rosbridge.handler import ConnectionReport
from robotether_server.relay.http import close_reasons
from robotether_server.relay.metrics import Metrics
from robotether_server.relay.observers import RelayObserver, new_refusals
from robotether_server.relay.records.event_writer import EventWriter
from robotether_server.relay.robots.connection import Connection
from robotether_server.relay.robots.drive_log import DriveLog
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import (
    HELP_CALLS_AT_ONCE,
    Change,
    GuardReport,
    Presence,
    Robot,
    SeenReport,
)
from robotether_server.settings import robot as robot_settings

CONNECTED, DISCONNECTED = utc(2026, 1, 1, 12, 3), utc(2026, 1, 1, 12, 30)
ONLINE = Presence(online=True, since=CONNECTED, address="198.51.100.7")


class Notes(EventWriter):
    def __init__(self, memory_database):
        super().__init__(memory_database)
        self.notes = []

    def add(self, entry):
        self.notes.append(replace(entry))
        super().add(entry)


@pytest.fixture
def event_writer(memory_database):
    return Notes(memory_database)


@pytest.fixture
def metrics():
    return Metrics(Traffic())


@pytest.fixture
def registry():
    return SessionRegistry()


@pytest.fixture
def observer(memory_database, event_writer, metrics, registry, caplog):
    caplog.set_level(logging.INFO)
    snapshot = Snapshot(memory_database.robots, memory_database.grants)
    return RelayObserver(event_writer, metrics, registry, lambda: snapshot)


def test_newest_call_for_help_of_each_source_waits(observer, event_writer, memory_database):
    """However often a robot calls; its settings name the pool."""
    settings = robot_settings.parse({"help": {"pool": "night"}})
    memory_database.robots[7] = replace(memory_database.robots[7], settings=settings)
    observer.help_called(7, HelpCall("stop", "stopped by ben"))
    for number in range(1000):
        observer.help_called(7, HelpCall("robot", f"call {number}", 1))
    observer.help_called(8, HelpCall("robot", "a robot that is gone"))
    assert event_writer.waiting() == 2
    assert HELP_CALLS_AT_ONCE <= len(event_writer.notes) < 2 * HELP_CALLS_AT_ONCE
    assert event_writer.notes[:2] == [
        HelpEntry(7, "stop", "stopped by ben", 2, "night"),
        HelpEntry(7, "robot", "call 0", 1, "night"),
    ]


def driving(robot, *, use="drive", reached=True):
    return Connection(1, "ann", robot, use, lambda _close_reason: None, reached)


def ended(connection, drive):
    return ConnectionReport(connection, None, close_reasons.client_left("sim1"), 1, drive)


def test_a_session_is_one_entry_from_its_begin_to_its_end(observer, event_writer):
    """A robot that tells of its health and heartbeats all the time costs the database nothing."""
    known = replace(ONLINE, agent_version="0.1.0")
    down, exposed = replace(known, ros="down", rtt_ms=1.0), replace(known, ros_exposed=True)
    observer.on_robot_change(Change("connected", 7, ONLINE))
    for presence in (known, down, exposed, down):
        observer.on_robot_change(Change("updated", 7, presence))
    observer.on_robot_change(Change("disconnected", 7, Presence(since=DISCONNECTED), "timeout"))
    begun = SessionEntry(7, CONNECTED, "198.51.100.7")
    entry = replace(begun, agent_version="0.1.0")
    ended_entry = replace(entry, ended_at=DISCONNECTED, end_code="timeout")
    notes = [begun, entry, replace(entry, ros_exposed=True), entry, ended_entry]
    assert event_writer.notes == notes
    assert event_writer.waiting() == 1


def test_a_drive_is_two_audit_lines_and_one_record(observer, event_writer, sim1, metrics):
    connection, drive = driving(sim1), a_drive()
    observer.connection(ConnectionReport(connection, "203.0.113.9", drive=drive))
    drive.command(10.0, 1.0, None)
    drive.command(10.1, 0.0, None)
    drive.dropped()
    close_reason = close_reasons.link_lost("sim1")
    observer.connection(ConnectionReport(connection, "203.0.113.9", close_reason, 12.345, drive))
    lines = [entry for entry in event_writer.notes if isinstance(entry, AuditEntry)]
    assert [entry.kind for entry in lines] == ["drive_started", "drive_ended"]
    summary = {"end_code": "link_lost", "fence": 13, "lasted_s": 12.3, "distance_m": 0.1}
    assert lines[1].details == summary | {"top_speed_m_s": 1.0}
    assert {(entry.actor, entry.robot, entry.address) for entry in lines} == {
        ("ann", "sim1", "203.0.113.9")
    }
    memory_database = [entry for entry in event_writer.notes if isinstance(entry, DriveEntry)]
    assert [entry.end_code for entry in memory_database] == [None, "link_lost"]
    assert b"commands_dropped_total 1.0" in metrics.render()


def test_a_drive_is_written_while_it_lasts(observer, event_writer, sim1):
    """A relay that is killed loses little of it; a drive that ended is written no more."""
    connection, drive = driving(sim1), a_drive()
    observer.connection(ConnectionReport(connection, None, drive=drive))
    drive.message()
    observer.write_drives()
    assert event_writer.notes[-1].messages == 1
    observer.connection(ended(connection, drive))
    count = len(event_writer.notes)
    observer.write_drives()
    assert len(event_writer.notes) == count


def guard_refused(**kinds):
    report = GuardReport("ready", refused=tuple(kinds.items()))
    return Change("guard_status", 7, replace(ONLINE, report=report))


def refused_in(event_writer):
    return [entry.refused for entry in event_writer.notes if isinstance(entry, DriveEntry)]


def test_what_the_guard_refused_is_the_drives(
    *, observer, event_writer, sim1, metrics, monkeypatch
):
    """What it refuses long after a drive is nobody's."""
    connection, drive = driving(sim1), a_drive()
    observer.on_robot_change(guard_refused(old=4, held=0))
    observer.connection(ConnectionReport(connection, None, drive=drive))
    observer.on_robot_change(guard_refused(old=6, held=0))
    observer.connection(ended(connection, drive))
    observer.on_robot_change(guard_refused(old=6, held=0))
    observer.on_robot_change(guard_refused(old=0, held=1))
    monkeypatch.setattr("robotether_server.relay.observers.GUARD_REPORTS_WITHIN_S", -1.0)
    observer.on_robot_change(guard_refused(old=0, held=2))
    assert refused_in(event_writer) == [{}, {"guard_old": 2}, {"guard_old": 2, "guard_held": 1}]
    assert b'guard_refusals_total{kind="old"} 2.0' in metrics.render()
    assert b'guard_refusals_total{kind="held"} 2.0' in metrics.render()


def test_what_a_driver_saw_is_the_drives(observer, event_writer, sim1, monkeypatch):
    """What the guard reports after the end is added to the record, but not long after."""

    def saw(age_ms):
        report = SeenReport(13, (age_ms,))
        observer.on_robot_change(Change("seen", 7, ONLINE, seen=report))

    connection, drive = driving(sim1), a_drive()
    saw(1.0)
    observer.connection(ConnectionReport(connection, None, drive=drive))
    saw(140.0)
    observer.connection(ended(connection, drive))
    saw(150.0)
    monkeypatch.setattr("robotether_server.relay.observers.GUARD_REPORTS_WITHIN_S", -1.0)
    saw(160.0)
    drives = [entry for entry in event_writer.notes if isinstance(entry, DriveEntry)]
    assert [entry.seen_max_ms for entry in drives] == [None, 140.0, 150.0]


def test_refusals_are_one_audit_line_of_their_connection(observer, event_writer, sim1):
    close_reason = close_reasons.client_left("sim1")
    connection = driving(sim1, use="observe")
    observer.connection(ConnectionReport(connection, None, close_reason, refused={"topic": 3}))
    (line,) = event_writer.notes
    assert (line.kind, line.details) == ("operations_refused", {"topic": 3})


def a_drive():
    return DriveLog(DriveEntry(7, "sim1", "ann", 13, CONNECTED), 0.5, Counter())


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 9)), max_size=20))
def test_of_what_is_refused_nothing_is_counted_twice(steps):
    """Guards that begin anew tell so first, as they do."""
    robot, refused, found, reported = Robot(7), 0, 0, 0
    new_refusals(robot, [("old", 0)])
    for anew, more in steps:
        if anew:
            reported = 0
            found += new_refusals(robot, [("old", reported)])["old"]
        reported, refused = reported + more, refused + more
        found += new_refusals(robot, [("old", reported)])["old"]
    assert found == refused
