"""What the scanner measures, and where its frames say that it is, are one world."""

from __future__ import annotations

import math
from typing import Any

import pytest
from sim_robot.devices import RANGE_MAX_M, Sensors
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


def seen_from_above(frame: str, point: Vector, links: dict[str, Any]) -> tuple[float, float]:
    """Where a point of `frame` is in the map."""
    while frame != "map":
        frame, transform = links[frame]
        turned = rotated(transform["rotation"], point)
        moved = transform["translation"]
        point = (turned[0] + moved["x"], turned[1] + moved["y"], turned[2] + moved["z"])
    return point[0], point[1]


def rotated(q: dict[str, float], v: Vector) -> Vector:
    """A vector turned by a quaternion: v + 2 u x (u x v + w v), u being its vector part."""
    u = (q["x"], q["y"], q["z"])
    inner = tuple(a + q["w"] * b for a, b in zip(cross(u, v), v, strict=True))
    x, y, z = (a + 2 * b for a, b in zip(v, cross(u, (inner[0], inner[1], inner[2])), strict=True))
    return (x, y, z)


def cross(a: Vector, b: Vector) -> Vector:
    """The cross product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def is_taken(x: float, y: float) -> bool:
    """Whether something stands there."""
    inside = 0 < x < SIZE_M and 0 < y < SIZE_M
    return not inside or any(item.holds(x, y) for item in World(SIZE_M).obstacles)


@pytest.mark.parametrize("kind", sorted(LASERS))
def test_the_scan_lies_on_walls_and_obstacles(kind: str) -> None:
    """By its frames: each ray is free until just before its end, and not just after it."""
    looker = Looker(kind)
    scan, links = looker.messages["/scan"], looker.links()
    start = HERE.x - SIZE_M / 2, HERE.y - SIZE_M / 2
    assert seen_from_above("base_link", (0, 0, 0), links) == pytest.approx(start)
    seen = 0
    for number, distance in enumerate(scan["ranges"]):
        if distance > RANGE_MAX_M:
            continue
        angle = scan["angle_min"] + number * scan["angle_increment"]
        for reach, taken in ((distance - 0.01, False), (distance + 0.01, True)):
            ray = (reach * math.cos(angle), reach * math.sin(angle), 0.0)
            x, y = seen_from_above(scan["header"]["frame_id"], ray, links)
            assert is_taken(x + SIZE_M / 2, y + SIZE_M / 2) is taken
        seen += 1
    assert seen > 100


def test_lasers_differ_as_real_ones_do() -> None:
    """One is turned and off the middle, one hangs upside down; the page's tests draw by the same numbers."""
    [turned], [hangs] = (
        Looker(kind).messages["/tf_static"]["transforms"] for kind in ("differential", "holonomic")
    )
    half = math.sqrt(0.5)
    assert turned["transform"]["translation"] == {"x": 0.15, "y": 0.0, "z": 0.3}
    assert turned["transform"]["rotation"] == pytest.approx({"x": 0, "y": 0, "z": half, "w": half})
    assert rotated(hangs["transform"]["rotation"], (0, 0, 1)) == pytest.approx((0, 0, -1))
