"""The simulated robot: what its README says of it, and a kind of it that no other test drives."""

import dataclasses
from pathlib import Path

import sim_robot
from sim_client import SETTINGS, until
from sim_robot.simulator import Simulator
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


async def test_car_steers() -> None:
    """The other kinds are driven in tests/e2e/test_driving.py."""
    type_name = "ackermann_msgs/AckermannDriveStamped"
    command = {"drive": {"speed": 1.0, "steering_angle": 0.4}}
    async with (
        Simulator(dataclasses.replace(SETTINGS, kind="ackermann")) as simulator,
        SocketClient(simulator.rosbridge.port) as client,
    ):
        await client.send(op="publish", topic="/cmd_vel", type=type_name, msg=command)
        turtle = simulator.robot.turtle
        await until("it moves to the left", lambda: turtle.pose.y > turtle.start.y + 0.1)
