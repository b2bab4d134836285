"""The background writer, with records that come and go."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest_asyncio
from relay_server import MemoryRecords, until, utc
from robotether_server.problems import RecordRefused
from robotether_server.relay.journal import Journal
from robotether_server.store.control import Stop, StopEntry
from robotether_server.store.fleet import AuditEntry, SessionEntry

NOW = utc(2026, 1, 1)


class Picky(MemoryRecords):
    """Records that refuse the sessions of robot 13, as for a robot that was deleted."""

    async def write(self, entries):
        if any(getattr(entry, "robot_id", 0) == 13 for entry in entries):
            raise RecordRefused("no such robot")
        return await super().write(entries)


class Broken(MemoryRecords):
    """Records with a defect that the sessions of robot 13 meet."""

    async def write(self, entries):
        if any(getattr(entry, "robot_id", 0) == 13 for entry in entries):
            raise TypeError("a defect")
        return await super().write(entries)


def session(robot_id: int = 7) -> SessionEntry:
    return SessionEntry(robot_id, NOW, "198.51.100.7")


@pytest_asyncio.fixture
async def journal(records: MemoryRecords) -> AsyncIterator[Journal]:
    """A journal that writes, and holds at most 5 entries."""
    async for journal in _running(records):
        yield journal


async def _running(records: MemoryRecords) -> AsyncIterator[Journal]:
    journal = Journal(records, max_waiting=5)
    task = asyncio.create_task(journal.run())
    yield journal
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_entries_are_written_in_order(journal, records):
    """What is added is written, the first first."""
    entries = [session(1), AuditEntry(NOW, "ann", "drive_started"), session(2)]
    for entry in entries:
        journal.add(entry)
    await journal.flush(5)
    assert records.written == entries


async def test_a_new_row_is_known_to_its_entry(journal, records):
    """The second write of a session updates its row."""
    entry = session()
    journal.add(entry)
    await journal.flush(5)
    assert entry.row_id == 1


async def test_a_session_waits_once_with_its_newest_state(journal, records):
    """A session that changes while the database is away is one entry."""
    records.down = True
    entry = session()
    for code in ("link_lost", "timeout"):
        entry.end_code = code
        journal.add(entry)
        await asyncio.sleep(0)
    assert journal.waiting() <= 1
    records.down = False
    await until(lambda: records.written, "it is written")
    assert [written.end_code for written in records.sessions()] == ["timeout"]


async def test_the_queue_is_bounded_and_says_what_it_drops(journal, records, caplog):
    """Beyond its bound the oldest entries go, and the log says so once."""
    records.down = True
    for robot_id in range(20):
        journal.add(session(robot_id))
    await until(lambda: "entries wait" in caplog.text, "the log says that the database is away")
    assert journal.waiting() == 5
    assert journal.dropped == 15
    assert caplog.text.count("the journal is full") == 1
    records.down = False
    await until(lambda: len(records.written) == 5, "the newest are written")
    assert [entry.robot_id for entry in records.sessions()] == [15, 16, 17, 18, 19]


async def test_a_stop_is_never_dropped(journal, records, caplog):
    """However much else waits, it is written when the database is back, with its newest state."""
    records.down = True
    entry = StopEntry(7, Stop(7, NOW, "ben"))
    journal.add(entry)
    for robot_id in range(20):
        journal.add(session(robot_id))
    await until(lambda: "entries wait" in caplog.text, "the log says that the database is away")
    assert journal.dropped > 0
    records.down = False
    await until(lambda: entry in records.written, "the stop is written")


async def test_one_refused_entry_does_not_keep_the_others(caplog):
    """What the database refuses is dropped with a line in the log; the rest is written."""
    records = Picky()
    async for journal in _running(records):
        for robot_id in (1, 13, 2):
            journal.add(session(robot_id))
        await journal.flush(5)
        assert [entry.robot_id for entry in records.sessions()] == [1, 2]
        assert journal.dropped == 1
        assert "no such robot" in caplog.text


async def test_an_entry_that_fails_takes_no_stop_with_it(caplog):
    """A defect in one line of the log costs that line."""
    records = Broken()
    stop = StopEntry(7, Stop(7, NOW, "ben"))
    async for journal in _running(records):
        for entry in (session(13), stop):
            journal.add(entry)
        await journal.flush(5)
        assert records.written == [stop]
        assert journal.dropped == 1
        assert "Traceback" in caplog.text


async def test_a_flush_ends_without_a_database(journal, records, caplog):
    """Stopping does not wait for ever, and says what was lost."""
    records.down = True
    journal.add(session())
    async with asyncio.timeout(1):
        await journal.flush(0.1)
    assert "1 entries of the journal are not written" in caplog.text
