"""The relay as a process: settings that stop the start, and signals that stop the relay."""

import asyncio
import os
import signal
from dataclasses import replace

from fake_robot import HOST, WAIT_S, RobotSession
from relay_server import (
    FAST,
    SESSION_KEY,
    relay_settings,
    run_python,
    running_relay,
    until,
    utc,
)
from robotether_server.db.control import Stop, StopEntry
from robotether_server.db.fleet import FormerSessions
from robotether_server.relay.main import run
from robotether_server.relay.options import Listen
from robotether_server.relay.records.journal import Journal


def test_a_fleet_needs_more_open_files_than_a_container_begins_with():
    script = (
        "import resource; from robotether_server.relay.http.event_loop import prepare_process; "
        "resource.setrlimit(resource.RLIMIT_NOFILE, (64, 2048)); prepare_process(); "
        "print(*resource.getrlimit(resource.RLIMIT_NOFILE))"
    )
    assert run_python("-c", script).stdout == "2048 2048\n"


async def test_sigterm_stops_it(caplog):
    caplog.set_level("INFO")
    listen = Listen(host=HOST, http_port=0, session_port=0, inside_port=0)
    running = asyncio.create_task(run(relay_settings(), listen))
    await until(lambda: "listening on" in caplog.text, "it listens")
    os.kill(os.getpid(), signal.SIGTERM)
    async with asyncio.timeout(WAIT_S):
        await running
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().remove_signal_handler(number)


NOON = utc(2026, 1, 1, 12)


async def test_a_stop_outlives_a_relay_that_is_killed_without_the_database(
    tmp_path, memory_database, sim1
):
    """The next one has that stop and those of the database, except what had ended, before it serves."""
    path = tmp_path / "journal.jsonl"
    ended, stop = Stop(sim1.id, NOON, "ann"), Stop(sim1.id, NOON, "ben")
    memory_database.add_robot(8, "sim2")
    killed = Journal(path)
    killed.add(StopEntry(sim1.id, stop, (ended.id,)))
    killed.close()
    of_database = Stop(8, NOON, "carl")
    memory_database.stops = [ended, of_database]
    async with running_relay(memory_database, journal=Journal(path)) as relay:
        stops = relay.relay.control.stops
        assert (stops.of(sim1.id), stops.of(8)) == (stop, of_database)
        assert list(relay.relay.registry.robot(sim1.id).stops.in_force) == [stop.id]
        await relay.relay.event_writer.flush(5)
        assert StopEntry(sim1.id, stop) in memory_database.written
        assert any(isinstance(entry, FormerSessions) for entry in memory_database.written)
    # A thread writes the journal, and has ended.
    assert path.read_bytes() == b""


async def test_the_last_entries_are_written_before_the_end(memory_database, sim1, monkeypatch):
    write = memory_database.write

    async def write_late(entries):
        await asyncio.sleep(0.2)
        return await write(entries)

    monkeypatch.setattr(memory_database, "write", write_late)
    session = RobotSession(sim1.id, kind="session", session_key=SESSION_KEY)
    async with running_relay(memory_database) as relay:
        await session.connect(relay.relay.session_port)
        await session.wait_configured()
    assert [entry.end_code for entry in memory_database.sessions()] == ["relay_stopping"]
    await session.close()


async def test_a_part_that_fails_is_in_the_log(memory_database, caplog):
    def fail():
        raise LookupError

    async with running_relay(memory_database, replace(FAST, drives_every_s=0.05)) as relay:
        relay.relay.observer.write_drives = fail
        await until(lambda: "task drives failed" in caplog.text, "the log says so")
