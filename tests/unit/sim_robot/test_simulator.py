"""The whole robot: its topics, its loop and what it prints."""

import asyncio
import contextlib
import dataclasses
import logging
import time
from pathlib import Path
from typing import Any

import pytest
import sim_robot
from sim_client import SETTINGS, until
from sim_robot.simulator import FixedRate, Simulator
from stopwatch import Stopwatch
from timed_websocket import SocketClient


async def test_topics_are_those_of_the_readme(simulator: Simulator) -> None:
    """Every topic and service of the robot stands in its README."""
    readme = (Path(sim_robot.__file__).parents[1] / "README.md").read_text()
    names = [*simulator.graph.bus.topics(), *(s.name for s in simulator.graph.services.all())]
    missing = [
        name for name in names if not name.startswith("/rosapi/") and f"`{name}`" not in readme
    ]
    assert missing == []


async def test_slower_parts_are_stepped_at_their_rates(simulator: Simulator) -> None:
    """In a second a listener gets one battery message, five scans and where the robot is ten times."""
    async with SocketClient(simulator.rosbridge.port) as client:
        for topic in ("/battery_state", "/scan", "/diagnostics", "/tf", "/tf_static"):
            await client.send(op="subscribe", topic=topic)
        seen: list[str] = []
        while seen.count("/battery_state") < 3:
            seen.append((await client.receive())["topic"])
    between = seen[seen.index("/battery_state") :]
    assert 9 <= between.count("/scan") <= 11
    assert 19 <= between.count("/tf") <= 22
    assert seen.count("/tf_static") == 1
    assert between.count("/diagnostics") in (2, 3)


@pytest.mark.parametrize("kind", ["holonomic", "ackermann"])
async def test_kind_of_robot_is_what_was_set(kind: str) -> None:
    """SIM_KIND decides on the type of /cmd_vel, and a command of it moves the robot as it should."""
    moves: dict[str, tuple[str, dict[str, Any]]] = {
        "holonomic": ("geometry_msgs/Twist", {"linear": {"y": 1.0}}),
        "ackermann": (
            "ackermann_msgs/AckermannDriveStamped",
            {"drive": {"speed": 1.0, "steering_angle": 0.4}},
        ),
    }
    type_name, command = moves[kind]
    async with (
        Simulator(dataclasses.replace(SETTINGS, kind=kind)) as simulator,
        SocketClient(simulator.rosbridge.port) as client,
    ):
        await client.send(op="publish", topic="/cmd_vel", type=type_name, msg=command)
        turtle = simulator.robot.turtle
        await until("it moves to the left", lambda: turtle.pose.y > turtle.start.y + 0.1)


async def test_taken_port_leaves_nothing_open(simulator: Simulator) -> None:
    """When the video port is taken, rosbridge's is free again."""
    settings = dataclasses.replace(SETTINGS, video_port=simulator.video.port)
    other = Simulator(settings)
    with pytest.raises(OSError, match="address already in use"):
        async with other:
            pass
    with pytest.raises(OSError, match="Connect call failed"):
        await asyncio.open_connection("127.0.0.1", other.rosbridge.port)


async def run_until(rate: FixedRate, calls: int) -> Stopwatch:
    """Run until that many calls were made; how long it took."""
    task = asyncio.create_task(rate.run())
    with Stopwatch() as stopwatch:
        await until(f"{calls} calls", lambda: rate.calls >= calls)
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task
    return stopwatch


async def test_long_delay_is_skipped_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    """After a stall of 0.5 s the loop does not race through the missed calls, and says so."""
    pauses = [0.5]
    rate = FixedRate(0.005, lambda: time.sleep(pauses.pop() if pauses else 0))
    with caplog.at_level(logging.WARNING):
        took = await run_until(rate, 10)
    # No more than there was time for, 110 on a machine that does not pause by itself.
    assert 90 <= rate.skipped <= took.clock_s / 0.005
    assert "cannot hold 200.0 Hz" in caplog.text
