"""A driven robot stops by itself, whichever of its processes dies or freezes, and can be driven again soon."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, suppress

import aiohttp
import processes
import pytest
from programs import Program
from sim_watch import SimWatch
from stack import Stack
from stopwatch import Stopwatch

ROBOT = "sim3"
AGENT, GUARD = "robotether_agent run", "robot-guard"
SPEED_M_S = 0.2
STANDS_WITHIN_S = 1.0
# A guard that hangs is known by its silence of 0.6 s, an agent by one of 1 s; a busy machine adds to that.
NOTICED_WITHIN_S = 1.5
DRIVES_WITHIN_S = 20.0
# The zeros last 0.5 s, here and there a little longer; then the guard is silent, so that it fights no other controller.
ZEROS_LAST_S = 1.0


@pytest.fixture(scope="module")
def program(stack: Stack) -> Program:
    """A program with an API token of the admin."""
    return Program(stack, stack.token("guard tests"))


@pytest.fixture
def watch(stack: Stack) -> Iterator[SimWatch]:
    """What the robot's wheels are told, seen on the robot itself, which is there and which nobody drives."""
    stack.wait_until_drivable(ROBOT)
    with SimWatch(stack, ROBOT) as watching:
        yield watching


@asynccontextmanager
async def driving(program: Program, watch: SimWatch) -> AsyncIterator[None]:
    """Drive ahead at 20 Hz inside the block, and connect again whenever that ends."""

    async def drive_once() -> None:
        twist = {"linear": {"x": SPEED_M_S, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}
        command = {"op": "publish", "topic": "/cmd_vel", "msg": twist}
        async with program.connect(ROBOT) as socket:
            await socket.send_json(
                {"op": "advertise", "topic": "/cmd_vel", "type": "geometry_msgs/Twist"}
            )
            reader = asyncio.ensure_future(_read(socket))
            try:
                while not reader.done():
                    await socket.send_json(command)
                    await asyncio.sleep(0.05)
            finally:
                reader.cancel()

    async def keep_driving() -> None:
        while True:
            with suppress(OSError, aiohttp.ClientError, AssertionError, RuntimeError, TypeError):
                await drive_once()
            await asyncio.sleep(0.1)

    task = asyncio.ensure_future(keep_driving())
    try:
        await moves(watch, time.monotonic())
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def _read(socket: aiohttp.ClientWebSocketResponse) -> None:
    async for _ in socket:
        pass


async def first(watch: SimWatch, since: float, *, zero: bool, within_s: float) -> float:
    """Wait for the first command after `since` that stands or moves; return the seconds that it took.

    Time in which the machine stands still does not count, as it does not for an agent that listens to its guard.
    """
    already_s = time.monotonic() - since
    with Stopwatch() as stopwatch:
        while True:
            for seen in watch.commands(since):
                if (seen.msg["linear"]["x"] == 0) == zero:
                    return seen.at - since
            if already_s + stopwatch.s > within_s:
                what, last = "stands" if zero else "moves", watch.commands(since)[-5:]
                raise AssertionError(f"after {within_s} s nothing {what}: {last}")
            await asyncio.sleep(0.01)


async def until_zeros_are_over() -> float:
    """Wait for as long as the guard's zeros last at most; return when that was."""
    with Stopwatch() as stopwatch:
        while True:
            await asyncio.sleep(0.05)
            if stopwatch.s > ZEROS_LAST_S:
                return time.monotonic()


async def stands(watch: SimWatch, since: float, within_s: float) -> float:
    """Wait for a zero, and return the moment at which it came."""
    return since + await first(watch, since, zero=True, within_s=within_s)


async def moves(watch: SimWatch, since: float) -> None:
    """Wait until the robot is driven."""
    await first(watch, since, zero=False, within_s=DRIVES_WITHIN_S)


def pids(stack: Stack, words: str) -> list[int]:
    """The robot's processes with these words in name and command, as this machine numbers them, the oldest first."""
    return processes.with_words(stack.container(ROBOT), words)


def send(stack: Stack, words: str, number: signal.Signals) -> float:
    """Send a signal to the oldest process with these words, and return when."""
    found = pids(stack, words)
    assert found, f"{ROBOT} runs no {words}"
    # The agent has forked the others, which have its command.
    os.kill(found[0], number)
    return time.monotonic()


@pytest.mark.parametrize(
    ("what", "within_s"),
    [
        pytest.param((GUARD, signal.SIGKILL), STANDS_WITHIN_S, id="guard killed"),
        pytest.param((GUARD, signal.SIGSTOP), NOTICED_WITHIN_S, id="guard frozen"),
        pytest.param((AGENT, signal.SIGKILL), STANDS_WITHIN_S, id="agent killed"),
        pytest.param((AGENT, signal.SIGTERM), STANDS_WITHIN_S, id="agent ended"),
    ],
)
async def test_a_process_that_dies_stops_the_robot(
    stack: Stack,
    program: Program,
    watch: SimWatch,
    what: tuple[str, signal.Signals],
    within_s: float,
) -> None:
    """The wheels get a zero within a second, and the next driver need not help."""
    async with driving(program, watch):
        lost_at = await asyncio.to_thread(send, stack, *what)
        stood_at = await stands(watch, lost_at, within_s)
        await moves(watch, stood_at)


async def test_a_frozen_agent_holds_the_robot(
    stack: Stack, program: Program, watch: SimWatch
) -> None:
    """Without signs of its agent the guard lets nobody drive, and when they come again it does."""
    async with driving(program, watch):
        frozen_at = await asyncio.to_thread(send, stack, AGENT, signal.SIGSTOP)
        try:
            await stands(watch, frozen_at, NOTICED_WITHIN_S)
            silent_from = await until_zeros_are_over()
            await asyncio.sleep(ZEROS_LAST_S)
            assert watch.commands(silent_from) == []
        finally:
            thawed_at = await asyncio.to_thread(send, stack, AGENT, signal.SIGCONT)
        await moves(watch, thawed_at)


async def test_a_stop_outlives_agent_and_guard(
    stack: Stack, program: Program, watch: SimWatch
) -> None:
    """A stopped robot stays stopped through the death of both, until somebody releases it."""
    async with driving(program, watch):
        try:
            pressed_at = time.monotonic()
            await asyncio.to_thread(_deed, program, "stop")
            stood_at = await stands(watch, pressed_at, STANDS_WITHIN_S)
            await asyncio.to_thread(send, stack, GUARD, signal.SIGKILL)
            await asyncio.to_thread(send, stack, AGENT, signal.SIGKILL)
            await asyncio.to_thread(stack.wait, "online again", lambda: stack.online(ROBOT), ROBOT)
            await asyncio.sleep(1)
            moved = [s for s in watch.commands(stood_at) if s.msg["linear"]["x"] != 0]
            assert moved == []
        finally:
            await asyncio.to_thread(
                stack.wait, "released", lambda: _deed(program, "release"), ROBOT
            )
        await moves(watch, time.monotonic())


def _deed(program: Program, deed: str) -> bool:
    path = f"/api/v1/robots/{ROBOT}/{deed}"
    status, _ = program.stack.request("POST", path, {}, program.headers)
    return status == 200
