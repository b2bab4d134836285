"""The background writer, with records that come and go."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest
import pytest_asyncio
from relay_server import MemoryDatabase, until, utc
from robotether_server.db.control import Stop, StopEntry
from robotether_server.db.fleet import AuditEntry, FormerSessions, SessionEntry
from robotether_server.problems import RecordRefused
from robotether_server.relay.db.event_writer import EventWriter

NOW = utc(2026, 1, 1)


class Picky(MemoryDatabase):
    """Records that refuse the sessions of robot 13, as for a robot that was deleted."""

    async def write(self, entries):
        if any(getattr(entry, "robot_id", 0) == 13 for entry in entries):
            raise RecordRefused("no such robot")
        return await super().write(entries)


class Broken(MemoryDatabase):
    """Records with a defect that the sessions of robot 13 meet."""

    async def write(self, entries):
        if any(getattr(entry, "robot_id", 0) == 13 for entry in entries):
            raise TypeError("a defect")
        return await super().write(entries)


def session(robot_id: int = 7) -> SessionEntry:
    return SessionEntry(robot_id, NOW, "198.51.100.7")


@pytest_asyncio.fixture
async def event_writer(memory_database: MemoryDatabase) -> AsyncIterator[EventWriter]:
    """A writer that runs, and holds at most 5 entries."""
    async for event_writer in _running(memory_database):
        yield event_writer


async def _running(memory_database: MemoryDatabase) -> AsyncIterator[EventWriter]:
    event_writer = EventWriter(memory_database, max_waiting=5)
    task = asyncio.create_task(event_writer.run())
    yield event_writer
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_entries_are_written_in_order(event_writer, memory_database):
    """What is added is written, the first first."""
    entries = [session(1), AuditEntry(NOW, "ann", "drive_started"), session(2)]
    for entry in entries:
        event_writer.add(entry)
    await event_writer.flush(5)
    assert memory_database.written == entries


async def test_a_new_row_is_known_to_its_entry(event_writer, memory_database):
    """The second write of a session updates its row."""
    entry = session()
    event_writer.add(entry)
    await event_writer.flush(5)
    assert entry.row_id == 1


async def test_a_session_waits_once_with_its_newest_state(event_writer, memory_database):
    """A session that changes while the database is away is one entry."""
    memory_database.down = True
    entry = session()
    for code in ("link_lost", "timeout"):
        entry.end_code = code
        event_writer.add(entry)
        await asyncio.sleep(0)
    assert event_writer.waiting() <= 1
    memory_database.down = False
    await until(lambda: memory_database.written, "it is written")
    assert [written.end_code for written in memory_database.sessions()] == ["timeout"]


async def test_the_queue_is_bounded_and_says_what_it_drops(event_writer, memory_database, caplog):
    """Beyond its bound the oldest entries go, and the log says so once."""
    memory_database.down = True
    for robot_id in range(20):
        event_writer.add(session(robot_id))
    await until(lambda: "entries wait" in caplog.text, "the log says that the database is away")
    assert event_writer.waiting() == 5
    assert event_writer.dropped == 15
    assert caplog.text.count("too many entries wait for the database") == 1
    memory_database.down = False
    await until(lambda: len(memory_database.written) == 5, "the newest are written")
    assert [entry.robot_id for entry in memory_database.sessions()] == [15, 16, 17, 18, 19]


@pytest.mark.parametrize("entry", [StopEntry(7, Stop(7, NOW, "ben")), FormerSessions(NOW)])
async def test_a_stop_and_the_end_of_former_sessions_are_never_dropped(
    event_writer, memory_database, caplog, entry
):
    """However much else waits, they are written when the database is back."""
    memory_database.down = True
    event_writer.add(entry)
    for robot_id in range(20):
        event_writer.add(session(robot_id))
    await until(lambda: "entries wait" in caplog.text, "the log says that the database is away")
    assert event_writer.dropped > 0
    memory_database.down = False
    await until(lambda: entry in memory_database.written, "it is written")


async def test_one_refused_entry_does_not_keep_the_others(caplog):
    """What the database refuses is dropped with a line in the log; the rest is written."""
    memory_database = Picky()
    async for event_writer in _running(memory_database):
        for robot_id in (1, 13, 2):
            event_writer.add(session(robot_id))
        await event_writer.flush(5)
        assert [entry.robot_id for entry in memory_database.sessions()] == [1, 2]
        assert event_writer.dropped == 1
        assert "no such robot" in caplog.text


async def test_an_entry_that_fails_takes_no_stop_with_it(caplog):
    """A defect in one line of the log costs that line."""
    memory_database = Broken()
    stop = StopEntry(7, Stop(7, NOW, "ben"))
    async for event_writer in _running(memory_database):
        for entry in (session(13), stop):
            event_writer.add(entry)
        await event_writer.flush(5)
        assert memory_database.written == [stop]
        assert event_writer.dropped == 1
        assert "Traceback" in caplog.text


async def test_a_flush_ends_without_a_database(event_writer, memory_database, caplog):
    """Stopping does not wait for ever, and says what was lost."""
    memory_database.down = True
    event_writer.add(session())
    async with asyncio.timeout(1):
        await event_writer.flush(0.1)
    assert "1 entries were not written to the database" in caplog.text
