"""The scanner sees the world around the robot, and the map waits for whoever comes."""

import math
from typing import Any

import pytest
from sim_client import DirectClient
from sim_robot.bus import Node, TopicMessage
from sim_robot.graph import Graph, make_graph
from sim_robot.kinematics import Pose
from sim_robot.robot import Robot
from sim_robot.sensors import MAP, RANGE_MAX_M, RAYS, SCAN, Sensors
from sim_robot.world import World


class Bench:
    """A robot with sensors, and what it publishes on /scan."""

    def __init__(self) -> None:
        self.graph: Graph = make_graph(2)
        self.robot = Robot(self.graph, 20.0)
        self.world = World(20.0)
        self.sensors = Sensors(self.graph, self.robot, self.world)
        self.seen: list[TopicMessage] = []

    def scan(self) -> dict[str, Any]:
        """One scan, as a listener gets it."""
        self.graph.bus.subscribe(SCAN, None, Node("/test"), self.seen.append)
        self.sensors.step()
        return self.seen[-1].values


def test_scan_fits_its_type() -> None:
    """A scan is a whole LaserScan with a range for each ray, from behind around by the right."""
    bench = Bench()
    scan = bench.scan()
    assert bench.graph.types.conform("sensor_msgs/LaserScan", scan, 0) == scan
    assert len(scan["ranges"]) == RAYS
    last = scan["angle_min"] + (RAYS - 1) * scan["angle_increment"]
    assert scan["angle_max"] == pytest.approx(last)


def test_scan_is_in_the_robots_own_frame() -> None:
    """A robot that looks at a wall 2 m ahead measures that in the middle of its scan, wherever it looks from."""
    bench = Bench()
    for pose in (Pose(18.0, 10.0, 0.0), Pose(10.0, 2.0, -math.pi / 2)):
        bench.robot.turtle.pose = pose
        scan = bench.scan()
        assert scan["ranges"][RAYS // 2] == pytest.approx(2.0, abs=1e-3)


def test_out_of_reach_is_infinite() -> None:
    """Nothing beyond the scanner's reach has a number."""
    bench = Bench()
    bench.robot.turtle.pose = Pose(1.0, 1.0, 0.0)
    ranges = bench.scan()["ranges"]
    assert math.inf in ranges
    assert max(value for value in ranges if value < math.inf) <= RANGE_MAX_M


def test_nobody_listens_nothing_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a subscriber no ray is cast."""
    bench = Bench()
    monkeypatch.setattr(bench.world, "distance", lambda *_: pytest.fail("a ray was cast"))
    bench.sensors.step()


async def test_map_comes_to_everybody_who_subscribes() -> None:
    """The map was published before; each client gets it once at once, though it subscribes twice."""
    graph = make_graph(2)
    robot = Robot(graph, 20.0)
    Sensors(graph, robot, World(20.0))
    for client in (DirectClient(graph), DirectClient(graph)):
        [message] = await client.send(op="subscribe", topic=MAP, id="one", throttle_rate=500)
        info, cells = message["msg"]["info"], message["msg"]["data"]
        assert len(cells) == info["width"] * info["height"]
        assert graph.types.conform("nav_msgs/OccupancyGrid", message["msg"], 0) == message["msg"]
        assert await client.send(op="subscribe", topic=MAP, id="two") == []


def test_map_and_odometry_have_one_origin() -> None:
    """The map's corner is where the world's is, seen from the start pose."""
    bench = Bench()
    latched = bench.graph.bus.latched(MAP)
    assert latched is not None
    corner = latched.values["info"]["origin"]["position"]
    start = bench.robot.turtle.start
    assert (corner["x"], corner["y"]) == (-start.x, -start.y)
