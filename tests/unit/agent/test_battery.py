"""The battery, from the robot's topic to the session's lines."""

import asyncio
from collections.abc import Mapping
from typing import Any

import pytest
from fake_cloud import eventually
from fake_rosbridge import FakeRosbridge
from robotether_agent import battery, rosbridge
from robotether_agent.battery import (
    BatterySettings,
    LevelTrend,
    UnitMemory,
    Vitals,
    battery_in,
    unit_shown,
)
from robotether_agent.rosbridge import RosGraph
from robotether_common.session import Battery

TOPICS = {"/battery_state": "sensor_msgs/msg/BatteryState"}


async def short_pause(_pause_s):
    await asyncio.sleep(0.05)


@pytest.fixture
def vitals_of(tmp_path, make_graph):
    return lambda url, pause=short_pause: Vitals(make_graph(url), tmp_path, pause=pause)


@pytest.fixture
def report(vitals_of, spawn):
    def start(url):
        return reports_of(vitals_of(url), spawn)

    return start


def reports_of(vitals, spawn):
    reported = []
    settings = BatterySettings(drive_topic="/cmd_vel")
    spawn(vitals.report(reported.append, lambda: settings))
    return reported


def state(percentage, status=2):
    return {"percentage": percentage, "power_supply_status": status, "voltage": 24.1}


def line(percent, *, charging=False):
    return {"type": "vitals", "battery": {"percent": percent, "charging": charging}}


NONE = {"type": "vitals", "battery": None}


async def test_changes_are_told_and_nothing_else(vitals_of, spawn):
    """The level is unknown without a session: the battery may be charged then, and the help rules keep running."""
    is_over, reported = asyncio.Event(), list[Mapping[str, Any]]()
    async with FakeRosbridge(TOPICS) as robot:
        vitals = vitals_of(robot.url, lambda _pause_s: is_over.wait())
        session = spawn(vitals.report(reported.append, BatterySettings))
        assert (await robot.subscription("/battery_state"))["throttle_rate"] == 5000
        for percentage in (0.81, 0.811, 0.809):
            await robot.publish("/battery_state", state(percentage))
        await eventually(lambda: reported == [line(81)], lambda: str(reported))
        await robot.publish("/battery_state", state(0.8))
        await robot.publish("/battery_state", state(0.79, status=1))
        newest = Battery(79, charging=True)
        await eventually(lambda: vitals.battery == newest, lambda: str(vitals.battery))
        assert reported == [line(81)]
        is_over.set()
        await eventually(lambda: len(reported) > 1, lambda: str(reported))
        assert reported == [line(81), line(79, charging=True)]
        session.cancel()
        await asyncio.gather(session, return_exceptions=True)
        assert vitals.battery is None


async def test_a_battery_that_falls_silent_is_unknown(report, monkeypatch):
    async with FakeRosbridge(TOPICS) as robot:
        reported = report(robot.url)
        await robot.subscription("/battery_state")
        await robot.publish("/battery_state", state(0.5))
        await eventually(lambda: reported == [line(50)], lambda: str(reported))
        # From the next message on.
        monkeypatch.setattr(battery, "SILENT_S", 0.05)
        await robot.publish("/battery_state", state(0.5))
        await eventually(lambda: reported == [line(50), NONE], lambda: str(reported))


async def test_a_robot_without_a_battery_tells_nothing(report):
    async with FakeRosbridge({"/scan": "sensor_msgs/LaserScan"}) as robot:
        reported = report(robot.url)
        await eventually(lambda: len(robot.got) > 2, lambda: str(robot.got))
        assert {operation["op"] for operation in robot.got} == {"call_service"}
        assert reported == []
        robot.topics = TOPICS
        await robot.subscription("/battery_state")


async def test_a_battery_that_shows_as_another_robots_is_left(vitals_of, spawn, monkeypatch):
    """Of robots on one graph those that start later are not known at first."""
    monkeypatch.setattr(rosbridge, "CHOSEN_AGAIN_EVERY_S", 0.05)
    kind, other = TOPICS["/battery_state"], "/robot1/battery_state"
    reported = []
    async with FakeRosbridge({other: kind}) as robot:
        settings = BatterySettings(drive_topic="/robot2/cmd_vel")
        spawn(vitals_of(robot.url).report(reported.append, lambda: settings))
        await robot.subscription(other)
        await robot.publish(other, state(0.9))
        await eventually(lambda: reported == [line(90)], lambda: str(reported))
        robot.topics = {other: kind, "/robot1/cmd_vel": "geometry_msgs/msg/Twist"}
        await eventually(lambda: reported == [line(90), NONE], lambda: str(reported))
        robot.topics["/robot2/battery_state"] = kind
        await robot.subscription("/robot2/battery_state")
        # That a driver restarts says nothing of whose battery it is.
        robot.topics = {}
        await asyncio.sleep(0.2)
        await robot.publish("/robot2/battery_state", state(0.2))
        await eventually(lambda: reported[2:] == [line(20)], lambda: str(reported))


async def test_a_hung_rosbridge_does_not_hold_up_the_sessions_end(tmp_path):
    """The guard is told of a lost session after this has ended."""
    async with FakeRosbridge(mode="slow_reader") as robot:
        graph = RosGraph(f"ws://127.0.0.1:{robot.port}")
        vitals = Vitals(graph, tmp_path)
        task = asyncio.ensure_future(vitals.report(lambda _: None, BatterySettings))
        await eventually(lambda: len(robot.got) == 1, lambda: str(robot.got))
        task.cancel()
        await asyncio.wait_for(asyncio.gather(task, return_exceptions=True), 10)
        await graph.close()


@pytest.mark.parametrize(
    ("message", "unit", "percent"),
    [
        (state(0.0), "fraction", 0),
        (state(0.0), "percent", 0),
        # Drivers that do not know the level leave it at 0, ROS's default.
        ({"percentage": 0.0, "voltage": 12.4}, None, None),
        ({"percentage": None, "charge": 0.0, "capacity": 8.0}, "percent", None),
        (state(0.5), None, 50),
        (state(1), "fraction", 100),
        (state(1), "percent", 1),
        (state(57.4), "percent", 57),
        # Of a unit that is not known, 1 is full or nearly empty, and a voltage may speak against the level.
        (state(1), None, None),
        (state(1.1), None, None),
        ({"percentage": 0.6, "voltage": 9.1}, None, None),
        ({"percentage": 0.57, "voltage": 12.1}, None, 57),
        ({"percentage": 0.57}, "fraction", 57),
        ({"percentage": None, "charge": 2.0, "capacity": 8.0}, "percent", 25),
        ({"percentage": float("nan"), "charge": 1.0, "capacity": 0.0}, None, None),
        (state(None), None, None),
        (state(101), "percent", None),
        (state(57), "fraction", None),
        ({"percentage": "full"}, None, None),
        ({"percentage": 10**400, "charge": 1.0, "capacity": -(10**400)}, None, None),
    ],
)
def test_a_level_in_doubt_is_unknown(message, unit, percent):
    assert battery_in(message, unit) == Battery(percent, charging=False)


def test_a_charger_is_seen_also_where_the_level_is_not():
    assert battery_in(state(None, status=1), None) == Battery(None, charging=True)


@pytest.mark.parametrize("message", [{}, {"percentage": 0.5, "present": False}])
def test_no_battery_is_none(message):
    assert battery_in(message, None) is None


@pytest.mark.parametrize(
    ("message", "unit"),
    [
        (state(3), "percent"),
        (state(1.1), None),
        (state(1), None),
        (state(1, status=4), "fraction"),
        # Four cells that are empty, or three that are half full.
        ({"percentage": 0.5, "voltage": 12.1}, None),
        ({"percentage": 0.8, "voltage": 4.0}, "fraction"),
        ({"percentage": 0.5, "charge": 4.0, "capacity": 8.0}, "fraction"),
        (state(0.0), None),
        (state(None), None),
    ],
)
def test_only_what_is_beyond_doubt_shows_the_unit(message, unit):
    assert unit_shown(message) == unit


@pytest.mark.parametrize(
    ("levels", "status", "unit"),
    [
        # A level each third of the time that shows a fraction.
        ([0.6, 0.58, 0.57, 0.55], 2, "fraction"),
        ([0.6, 0.58, 0.57], 2, None),
        # Percent next to empty, for which the time begins anew.
        ([1.1, 0.9, 0.75, 0.6, 0.4, 0.25, 0.1], 2, None),
        ([0.6, 0.3, 0.3, 0.3], 2, None),
        ([0.6, 0.3, 0.3, 0.3, 0.3], 2, "fraction"),
        ([1.0] * 9, 2, None),
        ([0.1] * 9, 2, None),
        # Percent that a charger lifts slowly at first.
        ([0.6] * 9, 1, None),
        ([0.6, 0.6, None, 0.6, 0.6], 2, None),
        # 255 as a fraction: unknown.
        ([0.57, 2.55, 2.55, 0.57, 2.55], 2, None),
        ([3.0, 2.9, 2.8], 2, "percent"),
    ],
)
def test_several_levels_show_the_unit(levels, status, unit):
    """Where neither voltage nor charge shows it; what is nearly empty does not last."""
    trend, message = LevelTrend(), {"power_supply_status": status}
    shown = [
        trend.unit_shown(message | {"percentage": level}, at * battery.STEADY_S / 3)
        for at, level in enumerate(levels)
    ]
    assert (shown[-1], set(shown[:-1])) == (unit, {None})


async def test_a_driver_without_a_voltage_is_believed_after_a_while(report, tmp_path, monkeypatch):
    async with FakeRosbridge(TOPICS) as robot:
        reported = report(robot.url)
        await robot.subscription("/battery_state")
        await robot.publish("/battery_state", state(0.6) | {"voltage": None})
        await eventually(lambda: len(reported) == 1, lambda: str(reported))
        assert reported[0]["battery"]["percent"] is None
        monkeypatch.setattr(battery, "STEADY_S", 0.0)
        await robot.publish("/battery_state", state(0.6) | {"voltage": None})
        await eventually(lambda: reported[1:] == [line(60)], lambda: str(reported))
    assert UnitMemory(tmp_path).of("/battery_state") == "fraction"


def test_a_unit_is_kept_for_its_topic(tmp_path):
    UnitMemory(tmp_path).keep("/a", "fraction")
    UnitMemory(tmp_path).keep("/a", "percent")
    assert UnitMemory(tmp_path).of("/a") == "percent"
    assert UnitMemory(tmp_path).of("/b") is None
    (tmp_path / "battery.json").write_text('{"topic": "/a", "unit": "volts"}')
    assert UnitMemory(tmp_path).of("/a") is None


@pytest.mark.parametrize(
    ("messages", "percent"),
    [
        # It fell there, or its voltage says so.
        ([{"percentage": 3.0}, {"percentage": 1.0}, {"percentage": 0.6}], 1),
        ([{"percentage": 0.6, "voltage": 9.1}], 1),
        # Another driver's, perhaps: of three cells that are half full, or four that are empty.
        ([{"percentage": 57.0}, {"percentage": 0.57}], None),
        ([{"percentage": 0.5, "voltage": 12.1}], None),
        # Another driver's beyond doubt, from then on.
        ([{"percentage": 0.8, "voltage": 4.0}, {"percentage": 0.57}], 57),
        # One that is not measured any more.
        ([{"percentage": 3.0}, {"percentage": None}], None),
    ],
)
async def test_percent_once_is_not_percent_for_good(vitals_of, tmp_path, messages, percent):
    UnitMemory(tmp_path).keep("/a", "percent")
    vitals, trend = vitals_of("ws://unused"), LevelTrend()
    for message in messages:
        vitals._read(message, "/a", None, trend)
    assert vitals.battery == Battery(percent, charging=False)
