"""What the scanner measures, and where its frames say that it is, are one world."""

from __future__ import annotations

import math
from typing import Any

import pytest
from sim_robot.devices import Sensors
from sim_robot.graph import Node, make_graph
from sim_robot.kinematics import Pose
from sim_robot.robot import RobotNode
from sim_robot.transforms import LASERS, Transforms
from sim_robot.world import World

SIZE_M = 20.0
HERE = Pose(7.0, 12.0, 0.8)
Vector = tuple[float, float, float]


class Looker:
    """A robot of some kind in the world, and the newest message of each of its topics."""

    def __init__(self, kind: str) -> None:
        graph = make_graph(2)
        robot = RobotNode(graph, SIZE_M, kind=kind)
        robot.turtle.pose = HERE
        sensors = Sensors(graph, robot, World(SIZE_M), LASERS[kind])
        transforms = Transforms(graph, robot, LASERS[kind])
        self.messages: dict[str, dict[str, Any]] = {}
        for topic in ("/scan", "/tf"):
            graph.bus.subscribe(topic, None, Node("/looker"), self._keep)
        sensors.step()
        transforms.step()
        latched = graph.bus.latched("/tf_static")
        assert latched is not None
        self.messages["/tf_static"] = latched.values
        for topic in ("/tf", "/tf_static"):
            graph.types.conform("tf2_msgs/TFMessage", self.messages[topic], 0)

    def _keep(self, message: Any) -> None:
        self.messages[message.topic] = message.values

    def links(self) -> dict[str, tuple[str, dict[str, Any]]]:
        """By the frame, its parent and where it is in that."""
        transforms = self.messages["/tf"]["transforms"] + self.messages["/tf_static"]["transforms"]
        return {t["child_frame_id"]: (t["header"]["frame_id"], t["transform"]) for t in transforms}


def rotated(q: dict[str, float], v: Vector) -> Vector:
    """A vector turned by a quaternion: v + 2 u x (u x v + w v), u being its vector part."""
    u = (q["x"], q["y"], q["z"])
    inner = tuple(a + q["w"] * b for a, b in zip(cross(u, v), v, strict=True))
    x, y, z = (a + 2 * b for a, b in zip(v, cross(u, (inner[0], inner[1], inner[2])), strict=True))
    return (x, y, z)


def cross(a: Vector, b: Vector) -> Vector:
    """The cross product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def test_lasers_differ_as_real_ones_do() -> None:
    """One is turned and off the middle, one hangs upside down; the page's tests draw by the same numbers."""
    [turned], [hangs] = (
        Looker(kind).messages["/tf_static"]["transforms"] for kind in ("differential", "holonomic")
    )
    half = math.sqrt(0.5)
    assert turned["transform"]["translation"] == {"x": 0.15, "y": 0.0, "z": 0.3}
    assert turned["transform"]["rotation"] == pytest.approx({"x": 0, "y": 0, "z": half, "w": half})
    assert rotated(hangs["transform"]["rotation"], (0, 0, 1)) == pytest.approx((0, 0, -1))
