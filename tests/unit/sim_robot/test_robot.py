"""The robot's topics and its service."""

import itertools
import math

import pytest
from sim_robot.bus import Node, TopicMessage
from sim_robot.graph import Graph, make_graph
from sim_robot.kinematics import STEP_S
from sim_robot.robot import PATH_POINTS, PATH_STEP_M, Robot


class Bench:
    """A robot with a clock that moves by steps only, and all that it publishes."""

    def __init__(self, ros_version: int = 2) -> None:
        self.graph: Graph = make_graph(ros_version)
        self.now_s = 0.0
        self.robot = Robot(self.graph, 20.0, lambda: self.now_s)
        self.seen: list[TopicMessage] = []
        for topic in ("/pose", "/odom"):
            self.graph.bus.subscribe(topic, None, Node("/test"), self.seen.append)

    def command(self, x: float = 0.0, y: float = 0.0, turn: float = 0.0) -> None:
        """Publish on /cmd_vel."""
        linear, angular = {"x": x, "y": y, "z": 0.0}, {"x": 0.0, "y": 0.0, "z": turn}
        self.graph.bus.publish("/cmd_vel", {"linear": linear, "angular": angular})

    def step(self, count: int) -> None:
        """Let time pass."""
        for _ in range(count):
            self.now_s += STEP_S
            self.robot.step()

    def last(self, topic: str) -> dict:
        """The newest message of a topic."""
        return next(m.values for m in reversed(self.seen) if m.topic == topic)


def test_pose_and_odometry_of_every_step() -> None:
    """Each step publishes both, and both fit their types."""
    bench = Bench()
    bench.step(10)
    assert [m.topic for m in bench.seen] == ["/pose", "/odom"] * 10
    for message in bench.seen[:2]:
        assert bench.graph.types.conform(message.key, message.values, 0) == message.values


def test_ros_1_header_has_seq() -> None:
    """A ROS 1 robot stamps with seq, secs and nsecs."""
    bench = Bench(ros_version=1)
    bench.step(3)
    header = bench.last("/odom")["header"]
    assert (header["seq"], header["frame_id"], sorted(header["stamp"])) == (
        3,
        "odom",
        ["nsecs", "secs"],
    )


def test_odometry_begins_at_its_origin() -> None:
    """Pose is in the world, odometry from the start pose on."""
    bench = Bench()
    bench.command(x=1.0, turn=0.5)
    bench.step(50)
    pose, odom = bench.last("/pose"), bench.last("/odom")
    position = odom["pose"]["pose"]["position"]
    assert position["x"] == pytest.approx(pose["x"] - 10.0, abs=1e-5)
    assert position["y"] == pytest.approx(pose["y"] - 10.0, abs=1e-5)
    rotation = odom["pose"]["pose"]["orientation"]
    assert 2 * math.atan2(rotation["z"], rotation["w"]) == pytest.approx(pose["theta"], abs=1e-6)


def test_backward_shows_in_odometry_only() -> None:
    """The speed of turtlesim has no sign, the odometry's has one."""
    bench = Bench()
    bench.command(x=-0.5)
    bench.step(1)
    assert bench.last("/pose")["linear_velocity"] == 0.5
    assert bench.last("/odom")["twist"]["twist"]["linear"]["x"] == -0.5


def test_silence_stops_the_robot() -> None:
    """1 s after the last command the velocity is zero."""
    bench = Bench()
    bench.command(x=1.0)
    bench.step(60)
    assert bench.last("/pose")["linear_velocity"] == 1.0
    bench.step(5)
    assert bench.last("/pose")["linear_velocity"] == 0.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -1e300])
def test_impossible_command_is_ignored(value: float, caplog: pytest.LogCaptureFixture) -> None:
    """A speed that is no number or beyond reason leaves the robot where it is."""
    bench = Bench()
    bench.command(turn=value)
    bench.command(x=value)
    bench.step(2)
    assert bench.last("/pose")["x"] == 10.0
    assert "no robot can follow" in caplog.text


def test_reset_service_leads_back() -> None:
    """/reset puts the robot to its start and forgets the path."""
    bench = Bench()
    bench.command(x=1.0)
    bench.step(60)
    assert bench.graph.services.get("/reset").handler({}) == {}
    bench.step(1)
    assert bench.last("/pose")["x"] == 10.0
    assert list(bench.robot.path) == [(10.0, 10.0)]


def test_path_is_bounded() -> None:
    """The path has a point every few centimetres and never more than its limit."""
    bench = Bench()
    for _ in range(4000):
        bench.command(x=5.0, turn=2.0)
        bench.step(1)
    path = list(bench.robot.path)
    assert len(path) == PATH_POINTS
    assert all(math.dist(a, b) >= PATH_STEP_M for a, b in itertools.pairwise(path))


def test_nothing_is_made_for_nobody() -> None:
    """Without a subscriber no message is built."""
    bench = Bench()
    for topic in ("/pose", "/odom"):
        for node in list(bench.graph.bus._topics[topic].subscribers):
            bench.graph.bus.unsubscribe(topic, node)
    bench.step(5)
    assert bench.seen == []
    assert bench.robot.steps == 5
