"""One life of the guard process, with a fake guard at the other end of real pipes."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from fake_cloud import eventually
from fake_guard import births, fake_guard_command, heard
from robotether_agent.guard_process import (
    SILENCE_S,
    START_S,
    TICK_S,
    GuardProcess,
    Hearing,
    guard_command,
    guard_environment,
)
from robotether_agent.problems import GuardDown

Start = Callable[[str], Awaitable[GuardProcess]]


@pytest.fixture
async def start(place: Path) -> AsyncIterator[Start]:
    """Starts fake guards by mode, and ends them."""
    started: list[GuardProcess] = []

    async def one(mode: str) -> GuardProcess:
        started.append(await GuardProcess.start(fake_guard_command(place, mode)))
        return started[-1]

    yield one
    for guard in started:
        await guard.kill()


async def served(guard: GuardProcess, lines: list[dict[str, Any]] | None = None) -> str:
    """Return why the guard's life ended."""
    taken = [] if lines is None else lines
    with pytest.raises(GuardDown) as caught:
        await asyncio.wait_for(guard.serve(lambda line: taken.append(dict(line))), 10)
    return caught.value.message


async def test_ticks_and_hands_lines_on(start, place):
    """The guard hears a tick every 0.2 s, and what it says arrives line by line."""
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
        ("rubbish", "what cannot be understood"),
    ],
)
async def test_what_is_wrong_with_a_guard_is_told(start, mode, why):
    """A guard that ends, hangs or talks nonsense is one that is down."""
    assert why in await served(await start(mode))


async def test_a_frozen_guard_is_noticed_soon(start):
    """A guard that is stopped in its tracks is given up soon after 0.6 s."""
    guard, lines = await start("serves"), []
    serving = asyncio.ensure_future(served(guard, lines))
    await eventually(lambda: len(lines) > 2, lambda: "it serves")
    os.kill(guard.pid, signal.SIGSTOP)
    frozen_at = asyncio.get_running_loop().time()
    assert await serving == "the guard hangs"
    assert asyncio.get_running_loop().time() - frozen_at < SILENCE_S + 2 * TICK_S + 1


async def test_a_guard_that_reads_nothing_is_killed(start):
    """What cannot be sent is bounded, not kept."""
    guard = await start("deaf")
    serving = asyncio.ensure_future(served(guard))
    while not serving.done():
        guard.send({"type": "lease", "fence": 1, "held": True, "pad": "x" * 10_000})
        await asyncio.sleep(0)
    assert await serving == "the guard was ended by SIGKILL"


async def test_is_asked_to_end_and_waited_for(start, place):
    """The orderly end says exit, so that the robot is stopped by then."""
    guard = await start("serves")
    await eventually(lambda: bool(births(place)), lambda: "it runs")
    await guard.end()
    assert heard(place)[-1]["type"] == "exit"


async def test_one_that_does_not_end_is_killed(start, place, monkeypatch):
    """The wait for a guard is bounded."""
    monkeypatch.setattr("robotether_agent.guard_process.EXIT_S", 0.2)
    guard = await start("stays")
    await eventually(lambda: bool(births(place)), lambda: "it runs")
    await asyncio.wait_for(guard.end(), 5)
    with pytest.raises(ProcessLookupError):
        os.kill(guard.pid, 0)


async def test_a_guard_that_cannot_be_started_is_down(place):
    """A missing program is told like a guard that ended."""
    with pytest.raises(GuardDown, match="cannot start the guard: No such file"):
        await GuardProcess.start([str(place / "none")])


def test_time_in_which_the_agent_stood_still_is_no_silence():
    """After a suspension the guard gets the time to be heard, and no more than that."""
    hearing = Hearing(0.0)
    hearing.heard(0.1)
    assert not hearing.is_lost(0.2)
    assert not hearing.is_lost(30.0)
    assert not hearing.is_lost(30.2)
    assert not hearing.is_lost(30.4)
    assert hearing.is_lost(30.7)


def test_a_start_may_take_longer_than_a_silence():
    """A small computer that boots loads Python for seconds; for ever it does not."""
    hearing, now = Hearing(0.0), 0.0
    while not hearing.is_lost(now):
        now += TICK_S
    assert START_S < now < START_S + 1


def test_the_guard_gets_no_secret():
    """Settings of the agent, its join token among them, and systemd's socket stay with the agent."""
    given = {"PATH": "/bin", "ROBOTETHER_TOKEN": "rj_x", "NOTIFY_SOCKET": "/run/x", "LANG": "C"}
    passed_on = guard_environment(given)
    assert {**passed_on, "PYTHONPATH": ""} == {"PATH": "/bin", "LANG": "C", "PYTHONPATH": ""}


def test_the_guard_is_the_one_that_came_with_the_agent():
    """The agent's own package comes before whatever else Python would find."""
    places = guard_environment({"PYTHONPATH": "/opt/more"})["PYTHONPATH"].split(":")
    assert Path(places[0], "robotether_agent", "guard_process.py").is_file()
    assert places[1:] == ["/opt/more"]


def test_the_command_names_both_directories():
    """The guard runs by the agent's own Python."""
    command = guard_command(Path("/state"), Path("/run/agent"), "debug")
    assert command[1:] == [
        "-m",
        "robotether_agent.guard",
        "--state-dir",
        "/state",
        "--run-dir",
        "/run/agent",
        "--log-level",
        "debug",
    ]
