"""A driven robot stops by itself when its guard or its agent dies, and can be driven again.

Frozen processes, and a stop that outlives both, are unit tests of the guard and of its supervisor.
"""

import asyncio
import os
import signal
import time
from contextlib import asynccontextmanager, suppress

import aiohttp
import processes
import pytest
from programs import Program
from sim_watch import SimWatch

ROBOT = "sim3"
AGENT, GUARD = "robotether_agent run", "robot-guard"
SPEED_M_S = 0.2
DRIVES_WITHIN_S = 20.0


@pytest.fixture(scope="module")
def program(stack):
    return Program(stack, stack.token("guard tests"))


@pytest.fixture
def watch(stack):
    """What the robot's wheels are told, seen on the robot itself, which is there and which nobody drives."""
    stack.wait_until_drivable(ROBOT)
    with SimWatch(stack, ROBOT) as watching:
        yield watching


@asynccontextmanager
async def driving(program, watch):
    """Drive ahead at 20 Hz inside the block, and connect again whenever that ends."""

    async def drive_once():
        twist = {"linear": {"x": SPEED_M_S, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}
        twist_message = {"op": "publish", "topic": "/cmd_vel", "msg": twist}
        async with program.connect(ROBOT) as socket:
            await socket.send_json(
                {"op": "advertise", "topic": "/cmd_vel", "type": "geometry_msgs/Twist"}
            )
            reader = asyncio.ensure_future(_read(socket))
            try:
                while not reader.done():
                    await socket.send_json(twist_message)
                    await asyncio.sleep(0.05)
            finally:
                reader.cancel()

    async def keep_driving():
        while True:
            with suppress(OSError, aiohttp.ClientError, AssertionError, RuntimeError, TypeError):
                await drive_once()
            await asyncio.sleep(0.1)

    task = asyncio.ensure_future(keep_driving())
    try:
        await command(watch, time.monotonic(), is_zero=False)
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def _read(socket):
    async for _ in socket:
        pass


async def command(watch, since, *, is_zero):
    """Wait for a command after `since` that stands or moves; return when it came. How soon: make bench, stopping."""
    end = time.monotonic() + DRIVES_WITHIN_S
    while True:
        for seen in watch.commands(since):
            if (seen.msg["linear"]["x"] == 0) == is_zero:
                return seen.at
        assert time.monotonic() < end, f"the last commands were {watch.commands(since)[-5:]}"
        await asyncio.sleep(0.01)


def send(stack, words, number):
    found = processes.with_words(stack.container(ROBOT), words)
    assert found, f"{ROBOT} runs no {words}"
    # The agent has forked the others, which have its command.
    os.kill(found[0], number)
    return time.monotonic()


@pytest.mark.parametrize("process", [GUARD, AGENT])
async def test_a_process_that_is_killed_stops_the_robot(stack, program, watch, process):
    """The wheels get a zero, and the next driver need not help."""
    async with driving(program, watch):
        lost_at = await asyncio.to_thread(send, stack, process, signal.SIGKILL)
        stood_at = await command(watch, lost_at, is_zero=True)
        await command(watch, stood_at, is_zero=False)
