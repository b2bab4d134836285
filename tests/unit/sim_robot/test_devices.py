"""Battery, lights, dock and diagnostics over topics and services."""

from collections.abc import AsyncIterator
from typing import Any

import pytest
from sim_client import DirectClient
from sim_robot.camera import Scene
from sim_robot.devices import WARN, Devices
from sim_robot.frames import FrameFeed
from sim_robot.graph import make_graph
from sim_robot.kinematics import Pose, Velocity
from sim_robot.robot import Robot


class Bench:
    """A robot with devices, and a client of its rosbridge."""

    def __init__(self) -> None:
        self.graph = make_graph(2)
        self.robot = Robot(self.graph, 20.0)
        self.feed = FrameFeed(_scene, 15.0)
        self.devices = Devices(self.graph, self.robot, (self.feed,))
        self.client = DirectClient(self.graph)

    async def call(self, service: str, **args: Any) -> dict[str, Any]:
        """Call a service that must exist."""
        [answer] = await self.client.send(op="call_service", service=service, args=args)
        assert answer["result"] is True, answer
        return answer["values"]

    async def told(self, topic: str) -> dict[str, Any]:
        """What comes on a topic after the next second."""
        await self.client.send(op="subscribe", topic=topic)
        self.devices.step()
        [message] = await self.client.received()
        return message["msg"]

    async def status(self, name: str) -> dict[str, Any]:
        """One part of the diagnostics."""
        told = await self.told("/diagnostics")
        return next(status for status in told["status"] if status["name"] == name)


def _scene() -> Scene:
    return Scene("t", 20.0, Pose(1, 1, 0), Velocity(), (), 0.0, 0)


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    """One robot's devices."""
    made = Bench()
    yield made
    made.client.client.close()
    await made.feed.close()


async def test_battery_is_told_each_second(bench: Bench) -> None:
    """The percentage goes down, and what is not measured is null."""
    first, second = await bench.told("/battery_state"), await bench.told("/battery_state")
    assert 0.8 < second["percentage"] <= first["percentage"] <= 0.81
    assert first["temperature"] is None


async def test_diagnostics_fit_their_type(bench: Bench) -> None:
    """A whole DiagnosticArray."""
    told = await bench.told("/diagnostics")
    assert bench.graph.types.conform("diagnostic_msgs/DiagnosticArray", told, 0) == told
    assert [status["name"] for status in told["status"]] == ["drive", "camera", "battery", "lights"]


async def test_lights_follow_topic_and_service(bench: Bench) -> None:
    """A Bool on /lights and a call of /set_lights switch the same lights, which the diagnostics tell."""
    assert (await bench.status("lights"))["message"] == "off"
    await bench.client.send(op="publish", topic="/lights", type="std_msgs/Bool", msg={"data": True})
    assert (await bench.status("lights"))["values"] == [{"key": "on", "value": "true"}]
    assert (await bench.call("/set_lights", data=False))["success"] is True
    assert (await bench.status("lights"))["message"] == "off"


async def test_dock_charges_a_robot_that_stands(bench: Bench) -> None:
    """Docked it charges; while it drives docking fails and says why."""
    assert (await bench.call("/dock"))["success"] is True
    assert (await bench.told("/battery_state"))["power_supply_status"] == 1
    bench.robot.turtle.command(Velocity(1.0), 0.0)
    answer = await bench.call("/dock")
    assert answer["success"] is False
    assert "drives" in answer["message"]


async def test_going_home_leads_to_the_start(bench: Bench) -> None:
    """/go_home puts the robot to its start."""
    bench.robot.turtle.pose = Pose(3.0, 4.0, 1.0)
    assert (await bench.call("/go_home"))["success"] is True
    assert bench.robot.turtle.pose == bench.robot.turtle.start


async def test_frozen_camera_is_a_warning(bench: Bench) -> None:
    """/sim/freeze_camera stops the cameras until it is called again, and the diagnostics warn."""
    await bench.call("/sim/freeze_camera", data=True)
    assert bench.feed.is_frozen
    assert (await bench.status("camera"))["level"] == WARN
    await bench.call("/sim/freeze_camera", data=False)
    assert not bench.feed.is_frozen


async def test_low_battery_and_wall_are_warnings(bench: Bench) -> None:
    """A low battery and a wall raise the level of their status."""
    assert (await bench.status("battery"))["level"] == 0
    bench.devices.battery.level = 0.1
    bench.robot.turtle.at_wall = True
    assert (await bench.status("battery"))["level"] == WARN
    assert (await bench.status("drive"))["level"] == WARN
