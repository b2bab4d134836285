"""What a relay leaves on its disk for the next one."""

import os
import threading
from datetime import timedelta

import pytest
from relay_server import utc
from robotether_server.db.control import DriveEntry, LeaseEnd, LeaseStart, Stop, StopEntry
from robotether_server.db.fleet import AuditEntry, HelpEntry
from robotether_server.relay.records import journal as module
from robotether_server.relay.records.journal import Journal

NOON = utc(2026, 1, 1, 12)
HOUR = timedelta(hours=1)
WITHIN_S = 5.0
START, END = LeaseStart(7, 3, 1, "ann", NOON), LeaseEnd(7, 3, NOON + HOUR)
LINE = AuditEntry(NOON, "ann", "drive_ended", "sim1", "192.0.2.1", {"fence": 3, "lasted_s": 1.5})


@pytest.fixture
def path(tmp_path):
    return tmp_path / "journal.jsonl"


def ended_drive(**others):
    times = {"started_at": NOON, "ended_at": NOON + HOUR, "end_code": "client_left"}
    return DriveEntry(7, "sim1", "ann", 3, **times, refused={"topic": 1}, **others)


def keep(path, *entries):
    journal = Journal(path)
    for entry in entries:
        journal.add(entry)
    journal.close()
    return journal


def test_each_kind_is_read_as_it_was_written(path):
    ended = ((NOON - HOUR, "ben"), (NOON, "ann"))
    stops = StopEntry(7, Stop(7, NOON, "ben", "smoke"), ended)
    call = HelpEntry(7, "robot", "lost", 2)
    entries = [START, LINE, ended_drive(distance_m=2.5, turned_rad=None), END, call, stops]
    keep(path, *entries, call)
    found = Journal(path).read()
    assert found == entries
    assert found[-1].ended == ended


@pytest.mark.parametrize("name", ["journal.jsonl", "journal.new"])
@pytest.mark.parametrize("kind", ["symlink", "fifo"])
def test_only_a_regular_file_is_a_journal(path, tmp_path, monkeypatch, name, kind):
    """A link leads to another's file, and a FIFO would hold the relay's start; a rewrite takes their place."""
    monkeypatch.setattr(module, "RETRY_EVERY_S", 0.0)
    others = tmp_path / "others"
    others.write_text("not ours")
    place = tmp_path / name
    if kind == "symlink":
        place.symlink_to(others)
    else:
        os.mkfifo(place)
    journal = Journal(path)
    assert journal.read() == []
    for _ in range(2):
        journal.rewrite([START])
        journal.wait(WITHIN_S)
    journal.close()
    assert others.read_text() == "not ours"
    assert path.is_file()
    assert not path.is_symlink()
    assert Journal(path).read() == [START]


def test_a_drive_and_a_robots_stops_are_read_once(path):
    stop = Stop(7, NOON, "ben")
    older, newer = StopEntry(7, stop), StopEntry(7, None, (stop.id,))
    keep(path, ended_drive(), older, StopEntry(8, stop), ended_drive(distance_m=2.5), newer)
    assert Journal(path).read() == [ended_drive(distance_m=2.5), newer, StopEntry(8, stop)]


def test_a_drive_that_lasted_ended_when_it_was_last_written(path):
    keep(path, DriveEntry(7, "sim1", "ann", 3, NOON, row_id=5))
    written_at = utc(2026, 1, 1, 13)
    text = path.read_text()
    path.write_text(text.replace(text.split('"')[3], written_at.isoformat()))
    [drive] = Journal(path).read()
    assert isinstance(drive, DriveEntry)
    assert (drive.ended_at, drive.end_code) == (written_at, "relay_restarted")
    assert drive.row_id is None


@pytest.mark.parametrize(
    "torn",
    [b'{"at":"2026-01-01T', b'{"at":"2026-01-01T12:00:00Z","kind":"Later","entry":{}}', b"\xff"],
)
def test_what_cannot_be_read_costs_itself_alone(path, caplog, torn):
    keep(path, START)
    path.write_bytes(path.read_bytes() + b"\n" + torn + b"\n" + torn)
    keep(path, END)
    assert Journal(path).read() == [START, END]
    assert caplog.text.count("2 lines") == 1


def test_an_entry_that_no_line_can_hold_costs_itself_alone(path, caplog):
    keep(path, START, AuditEntry(NOON, "\ud800", "robot_stopped"), END)
    assert Journal(path).read() == [START, END]
    assert "cannot keep" in caplog.text


def test_a_full_disk_is_said_once_and_tried_again(path, caplog, monkeypatch):
    journal = Journal(path)
    with monkeypatch.context() as full:
        full.setattr(module, "_open_regular", lambda _path, flags: os.open("/dev/full", flags))
        for entry in (START, LINE, END):
            journal.add(entry)
        journal.wait(WITHIN_S)
    assert caplog.text.count("No space left on device") == 1
    assert not journal.needs_rewrite(3)
    monkeypatch.setattr(module.time, "monotonic", lambda: float("inf"))
    assert journal.needs_rewrite(3)
    journal.rewrite([START, LINE])
    journal.wait(WITHIN_S)
    assert "can be written again" in caplog.text
    journal.add(END)
    journal.close()
    assert Journal(path).read() == [START, LINE, END]


def test_a_disk_that_hangs_holds_nobody_up(path, monkeypatch, caplog):
    """What it has no time for is written as a whole when it answers again."""
    monkeypatch.setattr(module, "MAX_TASKS", 2)
    answers, write = threading.Event(), module._write

    def hang(file, data):
        answers.wait(WITHIN_S)
        write(file, data)

    monkeypatch.setattr(module, "_write", hang)
    journal = Journal(path)
    for entry in (START, LINE, END):
        journal.add(entry)
    assert caplog.text.count("the disk does not answer") == 1
    monkeypatch.setattr(module.time, "monotonic", lambda: float("inf"))
    assert not journal.needs_rewrite(3)
    answers.set()
    journal.wait(WITHIN_S)
    assert journal.needs_rewrite(3)
    journal.rewrite([START, LINE, END])
    journal.close()
    assert Journal(path).read() == [START, LINE, END]
