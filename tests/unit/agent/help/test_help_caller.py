"""From the robot's topics to the session's lines that ask for help."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

import pytest
from fake_cameras import TopicRosbridge
from fake_cloud import eventually
from robotether_agent.help import caller as caller_module
from robotether_agent.help.caller import HelpCaller
from robotether_agent.help.rules import HelpConfig
from robotether_agent.rosbridge import RosGraph
from robotether_common.session import Battery

ALL = {
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/odom": "nav_msgs/msg/Odometry",
    "/plan": "nav_msgs/msg/Path",
}
FENCE = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0))


class World:
    """A robot's caller with what it sends; `reads` is set while the server reads."""

    def __init__(self, graph: RosGraph, spawn: Callable[..., asyncio.Future[Any]]) -> None:
        self.sent: list[tuple[Any, ...]] = []
        self.stopped: bool | None = None
        self.battery: Battery | None = None
        self.reads = asyncio.Event()
        self.reads.set()
        self.caller = HelpCaller(graph, lambda: (self.stopped, "ben"), lambda: self.battery)
        self._spawn = spawn
        self._session: asyncio.Future[Any] | None = None

    def new_session(self) -> None:
        if self._session is not None:
            self._session.cancel()
        self._session = self._spawn(self.caller.report(self.send, self.reads.wait))

    def send(self, message: Any) -> None:
        assert message["type"] == "help"
        self.sent.append((message["source"], message["reason"], message["priority"]))

    async def has_sent(self, *sources: str) -> None:
        await eventually(
            lambda: sorted(source for source, *_ in self.sent) == sorted(sources),
            lambda: str(self.sent),
        )


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("RETRY_S", "CHECK_EVERY_S", "SEND_EVERY_S"):
        monkeypatch.setattr(caller_module, name, 0.05)


@pytest.fixture
def start(make_graph, spawn) -> Callable[..., World]:
    def begin(url: str, config: HelpConfig) -> World:
        world = World(make_graph(url), spawn)
        world.caller.use(config)
        spawn(world.caller.watch())
        world.new_session()
        return world

    return begin


async def test_every_source_asks(start):
    config = HelpConfig(
        topic="/robotether/help",
        stopped=True,
        battery_below=20,
        diagnostics=True,
        geofence=FENCE,
        navigation_topic="/plan",
        navigation_silent_s=0.3,
    )
    async with TopicRosbridge(ALL) as robot:
        world = start(robot.url, config)
        for topic in ("/robotether/help", "/diagnostics", "/odom", "/plan"):
            await robot.subscription(topic)
        await world.has_sent("navigation")
        world.stopped, world.battery = True, Battery(5, charging=False)
        await robot.publish("/robotether/help", {"data": "lost"})
        await world.has_sent("navigation", "stop", "battery", "robot")
        await robot.publish("/odom", {"pose": {"pose": {"position": {"x": -5.0, "y": 0.0}}}})
        error = {"name": "motor", "level": 2, "message": "hot"}
        await robot.publish("/diagnostics", {"status": [error]})
        await world.has_sent("navigation", "stop", "battery", "robot", "geofence", "diagnostics")
        assert ("robot", "lost", 2) in world.sent


async def test_position_is_sent_while_somebody_uses_the_robot(start, monkeypatch):
    """One that was read long ago is unknown."""
    monkeypatch.setattr(caller_module, "POSITION_EVERY_S", 0.05)
    sent, used = [], []
    async with TopicRosbridge(ALL) as robot:
        world = start(robot.url, HelpConfig(geofence=FENCE))
        task = asyncio.ensure_future(world.caller.report_position(sent.append, lambda: bool(used)))
        await eventually(lambda: robot.subscribed("/odom"), lambda: str(robot.got))
        place = {"pose": {"pose": {"position": {"x": 5.0, "y": 1.0}}}}
        await robot.publish("/odom", place)
        await asyncio.sleep(0.3)
        assert sent == []
        used.append(True)
        await robot.publish("/odom", place)
        await eventually(
            lambda: sent == [{"type": "position", "x": 5.0, "y": 1.0}], lambda: str(sent)
        )
        monkeypatch.setattr(caller_module, "POSITION_HOLDS_S", 0.0)
        await robot.publish("/odom", place)
        await asyncio.sleep(0.3)
        assert len(sent) == 1
        task.cancel()


async def test_flood_is_one_call_at_a_time_and_the_newest(start, monkeypatch):
    monkeypatch.setattr(caller_module, "SEND_EVERY_S", 1.0)
    async with TopicRosbridge(ALL) as robot:
        world = start(robot.url, HelpConfig(topic="/robotether/help"))
        assert (await robot.subscription("/robotether/help"))["queue_length"] == 1
        began_s = time.monotonic()
        for number in range(50):
            await robot.publish("/robotether/help", {"data": f"call {number}"})
            await asyncio.sleep(0.01)
        await eventually(lambda: ("robot", "call 49", 2) in world.sent, lambda: str(world.sent))
        assert len(world.sent) <= 2 + time.monotonic() - began_s


async def test_call_waits_for_a_server_that_reads_it(start):
    async with TopicRosbridge(ALL) as robot:
        world = start(robot.url, HelpConfig(stopped=True))
        world.reads.clear()
        world.stopped = True
        await world.has_sent("stop")
        world.new_session()
        await world.has_sent("stop", "stop")
        world.reads.set()
        await asyncio.sleep(0.2)
        world.new_session()
        await asyncio.sleep(0.2)
        await world.has_sent("stop", "stop")
