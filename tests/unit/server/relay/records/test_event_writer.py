"""The background writer, with records that come and go."""

import asyncio
from contextlib import asynccontextmanager
from datetime import timedelta

import pytest
import pytest_asyncio
from relay_server import MemoryDatabase, until, utc
from robotether_server.db.control import DriveEntry, LeaseEnd, LeaseStart, Stop, StopEntry
from robotether_server.db.fleet import AuditEntry, FormerSessions, SessionEntry
from robotether_server.db.routes import RouteEnd
from robotether_server.problems import RecordRefusedError
from robotether_server.relay.records.event_writer import EventWriter
from robotether_server.relay.records.journal import MAX_STALE_LINES, Journal

NOW = utc(2026, 1, 1)


class Silent(MemoryDatabase):
    def __init__(self):
        super().__init__()
        self._asked = asyncio.Event()

    def is_asked(self):
        return self._asked.is_set()

    async def write(self, entries):
        self._asked.set()
        await asyncio.Event().wait()


def session(robot_id=7):
    return SessionEntry(robot_id, NOW, "198.51.100.7")


@pytest_asyncio.fixture
async def event_writer(memory_database):
    async with _at_work(event_writer := EventWriter(memory_database, max_waiting=5)):
        yield event_writer


async def test_the_audit_log_says_which_lines_it_lacks(event_writer, memory_database):
    memory_database.down = True
    for second in range(8):
        at = NOW + timedelta(seconds=second)
        event_writer.add(AuditEntry(at, "ann", "login", "sim1" if second < 2 else None))
    memory_database.down = False
    await until(lambda: len(memory_database.written) == 7, "all that is left is written")
    assert [(entry.kind, entry.robot, entry.details) for entry in memory_database.written[5:]] == [
        ("lines_lost", robot, {"count": count, "since": first, "until": last})
        for robot, count, first, last in (
            ("sim1", 2, NOW.isoformat(), (NOW + timedelta(seconds=1)).isoformat()),
            (None, 1, *[(NOW + timedelta(seconds=2)).isoformat()] * 2),
        )
    ]


@pytest.mark.parametrize("entry", [StopEntry(7, Stop(7, NOW, "ben")), FormerSessions(NOW)])
async def test_a_stop_and_the_end_of_former_sessions_are_never_dropped(
    event_writer, memory_database, caplog, entry
):
    memory_database.down = True
    event_writer.add(entry)
    for robot_id in range(20):
        event_writer.add(session(robot_id))
    await until(lambda: "entries wait" in caplog.text, "the log says that the database is away")
    assert event_writer.dropped > 0
    memory_database.down = False
    await until(lambda: entry in memory_database.written, "it is written")


class Picky(MemoryDatabase):
    def __init__(self, problem):
        super().__init__()
        self._problem = problem

    async def write(self, entries):
        if any(getattr(entry, "robot_id", 0) == 13 for entry in entries):
            raise self._problem
        return await super().write(entries)


@pytest.mark.parametrize(
    ("problem", "logged"),
    [(RecordRefusedError("no such robot"), "no such robot"), (TypeError("a defect"), "Traceback")],
)
async def test_one_refused_entry_does_not_keep_the_others(caplog, problem, logged):
    memory_database, first = Picky(problem), session(1)
    stop = StopEntry(7, Stop(7, NOW, "ben"))
    async with _at_work(event_writer := EventWriter(memory_database)):
        for entry in (first, session(13), stop):
            event_writer.add(entry)
        await event_writer.flush(5)
        assert memory_database.written == [first, stop]
        assert event_writer.dropped == 1
        assert logged in caplog.text


# What waits outlives the relay that is killed.


@pytest.fixture
def path(tmp_path):
    return tmp_path / "journal.jsonl"


WITHIN_S = 5.0
START, END = LeaseStart(7, 3, 1, "ann", NOW), LeaseEnd(7, 3, NOW)
LINE = AuditEntry(NOW, "ann", "drive_started")


@pytest.fixture
def drive():
    return DriveEntry(7, "sim1", "ann", 3, NOW, ended_at=NOW, end_code="client_left")


@asynccontextmanager
async def _at_work(event_writer):
    task = asyncio.create_task(event_writer.run())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        event_writer.close()


class _Settled(Journal):
    """Waits for the disk after each entry, as the loop of a relay that has time does."""

    def add(self, entry):
        super().add(entry)
        self.wait(WITHIN_S)


def _killed_with(path, memory_database, *entries):
    """Leave what a relay leaves that the database did not answer."""
    killed = EventWriter(memory_database, journal=_Settled(path))
    for entry in entries:
        killed.add(entry)
    killed.close()


def _kept(path):
    return [type(entry) for entry in Journal(path).read()]


async def test_the_next_relay_writes_what_a_killed_one_left(path, memory_database, drive):
    """Stops are for the stops; the ends of routes are handed on too: the database may still say that they last."""
    stop = StopEntry(7, Stop(7, NOW, "ben"))
    route_end = RouteEnd(3, NOW, "lease_lost", "ann", "sim2", "sim1")
    _killed_with(path, memory_database, session(), START, stop, LINE, drive, END, route_end)
    event_writer = EventWriter(memory_database, journal=_Settled(path))
    assert event_writer.restore() == ([stop], [route_end])
    event_writer.add(FormerSessions(NOW))
    assert event_writer.waiting() == 6
    async with _at_work(event_writer):
        await event_writer.flush(5)
    drive.row_id = 3
    assert memory_database.written == [START, LINE, drive, END, route_end, FormerSessions(NOW)]


async def test_what_a_killed_relay_left_stays_until_it_is_written(path, memory_database):
    _killed_with(path, memory_database, START)
    for _ in range(2):
        event_writer = EventWriter(memory_database, journal=_Settled(path))
        event_writer.restore()
    event_writer.add(END)
    assert Journal(path).read() == [START, END]
    async with _at_work(event_writer):
        await event_writer.flush(5)
    assert Journal(path).read() == []


async def test_what_is_being_written_stays_when_the_journal_is_written_anew(path, drive):
    """The database may yet not accept it."""
    silent = Silent()
    event_writer = EventWriter(silent, journal=_Settled(path))
    async with _at_work(event_writer):
        event_writer.add(START)
        await until(silent.is_asked, "the database is asked")
        for _ in range(2 * MAX_STALE_LINES):
            event_writer.add(drive)
    assert len(path.read_bytes().splitlines()) < 2 * MAX_STALE_LINES
    assert _kept(path) == [LeaseStart, DriveEntry]
