"""The robot's laser scanner and its map: /scan five times a second, /map once and latched.

Called by simulator.py. Nothing is measured while nobody listens. Ranges beyond the scanner's reach are infinite, which
rosbridge writes as null. The frame `map` coincides with `odom`: its origin is the start pose.
"""

import math
import time

from sim_robot.bus import Node
from sim_robot.graph import Graph
from sim_robot.messages import Values
from sim_robot.robot import BASE_FRAME, RobotNode
from sim_robot.world import World

NODE = Node("/sim_sensors")
SCAN, MAP = "/scan", "/map"
MAP_FRAME = "map"
SCAN_HZ = 5.0
RAYS = 180
RANGE_MIN_M, RANGE_MAX_M = 0.1, 12.0
CELL_M, CELLS_MAX = 0.1, 200


class Sensors:
    """Looks around from where the robot is."""

    def __init__(self, graph: Graph, robot: RobotNode, world: World) -> None:
        self._graph = graph
        self._robot = robot
        self._world = world
        self._seq = 0
        graph.bus.advertise(SCAN, "sensor_msgs/LaserScan", NODE)
        graph.bus.advertise(MAP, "nav_msgs/OccupancyGrid", NODE)
        graph.bus.publish(MAP, self._map(), latched=True)

    def step(self) -> None:
        """Publish a scan, if somebody listens."""
        self._seq += 1
        if self._graph.bus.has_subscribers(SCAN):
            self._graph.bus.publish(SCAN, self._scan())

    def _scan(self) -> Values:
        pose, step = self._robot.turtle.pose, 2 * math.pi / RAYS
        angles = (pose.theta - math.pi + number * step for number in range(RAYS))
        return {
            "header": self._graph.types.header(BASE_FRAME, time.time_ns(), self._seq),
            "angle_min": -math.pi,
            "angle_max": math.pi - step,
            "angle_increment": step,
            "time_increment": 0.0,
            "scan_time": 1 / SCAN_HZ,
            "range_min": RANGE_MIN_M,
            "range_max": RANGE_MAX_M,
            "ranges": [_in_range(self._world.distance(pose.x, pose.y, angle)) for angle in angles],
            "intensities": [],
        }

    def _map(self) -> Values:
        start, now_ns = self._robot.turtle.start, time.time_ns()
        cells = min(round(self._world.size_m / CELL_M), CELLS_MAX)
        corner = {"x": -start.x, "y": -start.y, "z": 0.0}
        return {
            "header": self._graph.types.header(MAP_FRAME, now_ns, 1),
            "info": {
                "map_load_time": self._graph.types.time(now_ns),
                "resolution": self._world.size_m / cells,
                "width": cells,
                "height": cells,
                "origin": {
                    "position": corner,
                    "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
                },
            },
            "data": self._world.grid(cells),
        }


def _in_range(distance_m: float) -> float:
    return round(distance_m, 3) if distance_m <= RANGE_MAX_M else math.inf
