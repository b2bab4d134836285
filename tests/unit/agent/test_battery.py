"""The battery, from the robot's topic to the session's lines."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any

import pytest
from fake_cameras import TopicRosbridge
from fake_cloud import eventually
from fake_rosbridge import FakeRosbridge
from robotether_agent import health
from robotether_agent.health import Vitals, battery_in, battery_topic
from robotether_common.session import Battery
from stopwatch import Stopwatch

TOPICS = {"/battery_state": "sensor_msgs/msg/BatteryState"}
EVERY_S = 0.2
Told = list[Mapping[str, Any]]


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    """A test waits for no half minute."""
    monkeypatch.setattr(health, "RETRY_S", 0.05)


@pytest.fixture
async def report() -> AsyncIterator[Callable[[str], Told]]:
    """Starts to tell, and ends it."""
    tasks = []

    def start(url: str) -> Told:
        reported: Told = []
        tasks.append(asyncio.ensure_future(Vitals(url, every_s=EVERY_S).report(reported.append)))
        return reported

    yield start
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


def state(percentage: float | None, status: int = 2) -> dict[str, object]:
    return {"percentage": percentage, "power_supply_status": status, "voltage": 24.1}


def line(percent: int, *, charging: bool = False) -> dict[str, object]:
    return {"type": "vitals", "battery": {"percent": percent, "charging": charging}}


NONE = {"type": "vitals", "battery": None}


async def until_subscribed(robot: TopicRosbridge, times: int = 1) -> None:
    await eventually(
        lambda: len(robot.subscribed("/battery_state")) >= times, lambda: str(robot.got)
    )


async def test_changes_are_told_and_nothing_else(report):
    """Once for each, and seldom: rosbridge is asked for one message in so long."""
    async with TopicRosbridge(TOPICS) as robot:
        reported = report(robot.url)
        await until_subscribed(robot)
        assert robot.subscribed("/battery_state")[0]["throttle_rate"] == 200
        for percentage in (0.81, 0.811, 0.809):
            await robot.publish("/battery_state", state(percentage))
        await eventually(lambda: reported == [line(81)], lambda: str(reported))
        with Stopwatch() as stopwatch:
            await robot.publish("/battery_state", state(0.8))
            await robot.publish("/battery_state", state(0.79, status=1))
            await eventually(lambda: len(reported) > 1, lambda: str(reported))
        assert reported == [line(81), line(79, charging=True)]
        assert stopwatch.s < 2 * EVERY_S + 0.2


async def test_a_rosbridge_that_restarts_is_found_again(report):
    async with TopicRosbridge(TOPICS) as robot:
        reported = report(robot.url)
        await until_subscribed(robot)
        await robot.publish("/battery_state", state(0.5))
        await eventually(lambda: reported == [line(50)], lambda: str(reported))
        await robot.stop()
        await eventually(lambda: reported[-1] == NONE, lambda: str(reported))
        await robot.start()
        await until_subscribed(robot, 2)
        await robot.publish("/battery_state", state(0.4))
        await eventually(lambda: reported[-1] == line(40), lambda: str(reported))


async def test_a_battery_that_falls_silent_is_unknown(report, monkeypatch):
    """An old charge is not told as today's."""
    monkeypatch.setattr(health, "SILENT_S", 0.3)
    async with TopicRosbridge(TOPICS) as robot:
        reported = report(robot.url)
        await until_subscribed(robot)
        await robot.publish("/battery_state", state(0.5))
        await eventually(lambda: reported == [line(50), NONE], lambda: str(reported))


async def test_a_robot_without_a_battery_tells_nothing(report):
    """And holds no connection: it is looked up again now and then."""
    async with TopicRosbridge({"/scan": "sensor_msgs/LaserScan"}) as robot:
        reported = report(robot.url)
        await eventually(lambda: len(robot.got) > 2, lambda: str(robot.got))
        assert {operation["op"] for operation in robot.got} == {"call_service"}
        assert reported == []
        robot.topics = TOPICS
        await until_subscribed(robot)


async def test_a_hung_rosbridge_does_not_hold_up_the_sessions_end():
    """The guard is told of a lost session after this has ended."""
    async with FakeRosbridge("slow_reader") as robot:
        vitals = Vitals(f"ws://127.0.0.1:{robot.port}")
        task = asyncio.ensure_future(vitals.report(lambda _: None))
        await eventually(lambda: len(robot.got) == 1, lambda: str(robot.got))
        with Stopwatch() as stopwatch:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
        assert stopwatch.s < 0.05


@pytest.mark.parametrize(
    ("message", "battery"),
    [
        (state(0.0), Battery(0, charging=False)),
        (state(1), Battery(100, charging=False)),
        (state(57.4, status=1), Battery(57, charging=True)),
        ({"percentage": None, "charge": 2.0, "capacity": 8.0}, Battery(25, charging=False)),
        ({"percentage": float("nan"), "charge": 1.0, "capacity": 0.0}, None),
        (state(None), None),
        (state(-1), None),
        (state(101), None),
        ({"percentage": True}, None),
        ({"percentage": "full"}, None),
        ({"percentage": 10**400, "charge": 1.0, "capacity": -(10**400)}, None),
        ({}, None),
    ],
)
def test_what_a_battery_says(message, battery):
    assert battery_in(message) == battery


def test_the_usual_topic_is_the_robots_own():
    """Of several; else the first by name, and none of another type."""
    kind = "sensor_msgs/BatteryState"
    assert battery_topic({"/arm/battery": kind, "/battery_state": kind}) == "/battery_state"
    assert battery_topic({"/b": kind, "/a": kind, "/battery": "std_msgs/Float32"}) == "/a"
    assert battery_topic({}) is None
