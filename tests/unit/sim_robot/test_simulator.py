"""The simulated robot: what its README says of it, its kinds, and what its camera draws."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import pytest
import sim_robot
from sim_client import SETTINGS, until
from sim_robot.first_person import draw
from sim_robot.kinematics import Pose
from sim_robot.simulator import Simulator
from sim_robot.world import World
from timed_websocket import SocketClient


async def test_topics_are_those_of_the_readme() -> None:
    readme = (Path(sim_robot.__file__).parents[1] / "README.md").read_text()
    async with Simulator(SETTINGS) as simulator:
        graph = simulator.graph
        names = [*graph.bus.topics(), *(service.name for service in graph.services.all())]
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


@pytest.mark.parametrize("size", [(640, 480), (333, 250), (1, 1), (2048, 2), (2, 2048)])
@pytest.mark.parametrize("world_m", [2, 20, 1000])
def test_there_is_a_frame_everywhere(world_m: float, size: tuple[int, int]) -> None:
    """A frame has the wanted size in corners, beyond a wall, inside an obstacle and just before it."""
    world = World(world_m)
    post = world.obstacles[0]
    left, middle = post.bounds[0], sum(post.bounds[1::2]) / 2
    places = [(0, 0), (world_m, world_m), (world_m / 2, 0), (left - 0.01, middle), (left, middle)]
    for x, y in [*places, (left + 0.02, middle)]:
        for theta in (-math.pi, -0.8, 0, 0.5, 3.1):
            assert draw(world, Pose(x, y, theta), size).size == size
