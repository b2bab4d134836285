"""A guard as the agent sees it: its lines, its silence and its end."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from fake_cloud import echo, eventually
from fake_guard import births, fake_guard_command
from openssh_server import is_alive
from robotether_agent.guard.child_process import (
    TICK_S,
    GuardProcess,
    SilenceDetector,
)
from robotether_agent.guard.fork_server import START_S, ForkServer
from robotether_agent.own_programs import program_environment
from robotether_agent.problems import GuardDownError

Start = Callable[[str], Awaitable[GuardProcess]]


@pytest.fixture
async def start(place: Path) -> AsyncIterator[Start]:
    started: list[GuardProcess] = []
    servers: list[ForkServer] = []

    async def start_guard(mode: str) -> GuardProcess:
        servers.append(ForkServer.start(fake_guard_command(place, mode)))
        started.append(await GuardProcess.start(servers[-1]))
        return started[-1]

    yield start_guard
    for guard in started:
        await guard.kill()
    for server in servers:
        server.close()


async def served(guard: GuardProcess, lines: list[dict[str, Any]] | None = None) -> str:
    taken = [] if lines is None else lines
    with pytest.raises(GuardDownError) as caught:
        await asyncio.wait_for(guard.serve(lambda line: taken.append(dict(line))), 60)
    return caught.value.message


async def test_ticks_and_hands_lines_on(start, place):
    guard, lines = await start("serves"), []
    serving = asyncio.ensure_future(served(guard, lines))
    guard.send({"type": "stop", "id": "5f0c", "by": "ben"})
    await eventually(
        lambda: any(line.get("answers") == "5f0c" for line in lines), lambda: f"an answer: {lines}"
    )
    assert lines[0] == {"type": "ready", "port": births(place)[0]["port"]}
    text = (place / "heard.jsonl").read_text()
    await eventually(
        lambda: (place / "heard.jsonl").read_text().count('"tick"') > text.count('"tick"') + 2,
        lambda: "more ticks",
    )
    os.kill(guard.pid, signal.SIGKILL)
    assert await serving == "the guard was ended by SIGKILL"


@pytest.mark.parametrize(
    ("mode", "why"),
    [
        ("dies", "ended with status 1"),
        ("hangs", "the guard hangs"),
        ("rubbish", "an invalid line"),
    ],
)
async def test_what_is_wrong_with_a_guard_is_told(start, mode, why):
    assert why in await served(await start(mode))


async def test_a_guard_that_reads_nothing_is_killed(start):
    guard = await start("deaf")
    serving = asyncio.ensure_future(served(guard))
    while not serving.done():
        guard.send({"type": "lease", "fence": 1, "held": True, "pad": "x" * 10_000})
        await asyncio.sleep(0)
    assert await serving == "the guard was ended by SIGKILL"


async def test_frames_alone_never_kill_a_guard(start):
    """What waits behind them would: a guard that is late misses some, and they are unknown to it."""
    guard = await start("deaf")
    serving = asyncio.ensure_future(served(guard))
    for _ in range(2000):
        guard.offer({"type": "frame", "pad": "x" * 1000})
        await asyncio.sleep(0)
    assert not serving.done()
    os.kill(guard.pid, signal.SIGTERM)
    assert await serving == "the guard was ended by SIGTERM"


async def test_a_guard_that_has_just_begun_can_be_ended(place):
    """A signal that comes before its process has set itself up is not lost."""
    server = ForkServer.start(fake_guard_command(place, "serves"))
    await server.check()
    for _ in range(20):
        guard = await GuardProcess.start(server)
        os.kill(guard.pid, signal.SIGTERM)
        assert await served(guard) == "the guard was ended by SIGTERM"
        await guard.kill()
    server.close()


async def test_one_that_does_not_end_is_killed(start, place, monkeypatch):
    monkeypatch.setattr("robotether_agent.guard.child_process.EXIT_S", 0.2)
    guard = await start("stays")
    await eventually(lambda: bool(births(place)), lambda: "it runs")
    await asyncio.wait_for(guard.end(), 5)
    await eventually(lambda: not is_alive(guard.pid), lambda: "it is killed")


async def test_a_guard_that_cannot_be_started_is_down(place):
    with pytest.raises(GuardDownError, match="cannot start the guard: No such file"):
        ForkServer.start([str(place / "none")])


def test_time_in_which_the_agent_stood_still_is_no_silence():
    """After a suspension the guard gets the time to be heard, and no more than that."""
    hearing = SilenceDetector(0.0)
    hearing.on_line(0.1)
    assert not hearing.is_lost(0.2)
    assert not hearing.is_lost(30.0)
    assert not hearing.is_lost(30.2)
    assert not hearing.is_lost(30.4)
    assert hearing.is_lost(30.7)


def test_a_start_may_take_longer_than_a_silence():
    """A small computer that boots loads Python for seconds; for ever it does not."""
    hearing, now = SilenceDetector(0.0), 0.0
    while not hearing.is_lost(now):
        now += TICK_S
    assert START_S < now < START_S + 1


def test_the_guard_gets_no_secret():
    """Settings of the agent, its join token among them, and systemd's socket stay with the agent."""
    given = {"PATH": "/bin", "ROBOTETHER_TOKEN": "rj_x", "NOTIFY_SOCKET": "/run/x", "LANG": "C"}
    passed_on = program_environment(given)
    assert {**passed_on, "PYTHONPATH": ""} == {"PATH": "/bin", "LANG": "C", "PYTHONPATH": ""}


def test_the_guard_is_the_one_that_came_with_the_agent():
    places = program_environment({"PYTHONPATH": "/opt/more"})["PYTHONPATH"].split(":")
    assert Path(places[0], "robotether_agent", "guard", "__main__.py").is_file()
    assert Path(places[-2], "robotether_common").is_dir()
    assert places[-1] == "/opt/more"


async def test_a_stop_outlives_the_agent(cloud, start_agent):
    """A robot that somebody stopped is still stopped after its next boot, and says so to the server."""
    agent = start_agent(cloud, guard="on")
    link = await cloud.link("session")
    link.send({"type": "stop", "id": "5f0c", "by": "ben"})
    await agent.until(lambda status: status.stopped_by == "ben", "stopped")
    await agent.stop()
    agent = start_agent(cloud, guard="on")
    link = await cloud.link("session", number=2)
    await eventually(lambda: bool(link.of_type("guard")), lambda: f"{link.received}")
    assert link.of_type("guard")[0]["stopped"]
    await agent.until(lambda status: status.stopped_by == "ben", "still stopped")


async def test_without_a_guard_the_forward_is_bare(cloud, start_agent, caplog):
    """The port leads straight to rosbridge, and log, status and server say so."""
    agent = start_agent(cloud, guard="off")
    status = await agent.until_connected()
    assert await echo(cloud.ports[0], "x", key="") == "x"
    assert status.guard == "off"
    assert (await cloud.link("session")).of_type("hello")[0]["guard"] == "off"
    assert "nothing stops this robot" in caplog.text
