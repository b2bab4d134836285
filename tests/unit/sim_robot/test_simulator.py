"""The whole robot: its topics, its loop and what it prints."""

import asyncio
import dataclasses
from pathlib import Path
from typing import Any

import pytest
import sim_robot
from sim_client import SETTINGS, SocketClient, until
from sim_robot.simulator import Simulator


async def test_topics_are_those_of_the_readme(simulator: Simulator) -> None:
    """Every topic and service of the robot stands in its README."""
    readme = (Path(sim_robot.__file__).parents[1] / "README.md").read_text()
    names = [*simulator.graph.bus.topics(), *(s.name for s in simulator.graph.services.all())]
    missing = [
        name for name in names if not name.startswith("/rosapi/") and f"`{name}`" not in readme
    ]
    assert missing == []


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


@pytest.mark.parametrize("count", [0, 1, 2])
async def test_it_has_as_many_cameras_as_were_set(count: int) -> None:
    """SIM_CAMERAS leaves out the rear one first, with its topics."""
    simulator = Simulator(dataclasses.replace(SETTINGS, cameras=count))
    images = [topic for topic in simulator.graph.bus.topics() if "/image_raw" in topic]
    cameras = ["/camera/image_raw", "/rear/image_raw"][:count]
    assert sorted(images) == sorted([*cameras, *(f"{camera}/compressed" for camera in cameras)])


async def test_taken_port_leaves_nothing_open(simulator: Simulator) -> None:
    """When the video port is taken, rosbridge's is free again."""
    settings = dataclasses.replace(SETTINGS, video_port=simulator.video.port)
    other = Simulator(settings)
    with pytest.raises(OSError, match="address already in use"):
        async with other:
            pass
    with pytest.raises(OSError, match="Connect call failed"):
        await asyncio.open_connection("127.0.0.1", other.rosbridge.port)
