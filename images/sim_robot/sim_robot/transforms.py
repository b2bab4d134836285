"""Where the robot's frames are in each other: /tf_static once, latched, and /tf ten times a second.

Called by simulator.py; devices.py measures from where `LASERS` has the scanner. The frame `map` coincides with `odom`,
whose origin is the start pose.
"""

import math
import time
from dataclasses import dataclass

from sim_robot.graph import Graph, Node
from sim_robot.kinematics import Pose
from sim_robot.messages import Values
from sim_robot.robot import BASE_FRAME, ODOM_FRAME, RobotNode, yaw_rotation

NODE = Node("/robot_state_publisher")
TF, TF_STATIC = "/tf", "/tf_static"
TF_HZ = 10.0
MAP_FRAME, LASER_FRAME = "map", "laser"
_ORIGIN = Pose(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Mount:
    """Where the scanner is in base_link: m, m, m, rad. One that hangs upside down measures clockwise from above."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.3
    yaw: float = 0.0
    upside_down: bool = False

    def placed(self, base: Pose) -> Pose:
        """Give the scanner's pose in the frame in which the robot has the pose `base`."""
        cos, sin = math.cos(base.theta), math.sin(base.theta)
        x, y = base.x + cos * self.x - sin * self.y, base.y + sin * self.x + cos * self.y
        return Pose(x, y, base.theta + self.yaw)

    def heading(self, angle: float) -> float:
        """Give the direction, from the scanner's heading, of the ray that it measures at `angle`."""
        return -angle if self.upside_down else angle

    def rotation(self) -> Values:
        """Give its quaternion: half a turn about x if it hangs, then the yaw."""
        turned = yaw_rotation(self.yaw)
        if self.upside_down:
            return {"x": turned["w"], "y": turned["z"], "z": 0.0, "w": 0.0}
        return turned


# By the kind of robot.
LASERS = {
    "differential": Mount(x=0.15, yaw=math.pi / 2),
    "holonomic": Mount(y=-0.1, yaw=-math.pi / 4, upside_down=True),
    "ackermann": Mount(x=0.4),
}


class Transforms:
    """Publishes the frames of one robot."""

    def __init__(self, graph: Graph, robot: RobotNode, laser: Mount) -> None:
        self._graph = graph
        self._robot = robot
        self._seq = 0
        graph.bus.advertise(TF, "tf2_msgs/TFMessage", NODE)
        graph.bus.advertise(TF_STATIC, "tf2_msgs/TFMessage", NODE)
        position = {"x": laser.x, "y": laser.y, "z": laser.z}
        fixed = self._transform(BASE_FRAME, LASER_FRAME, position, laser.rotation())
        graph.bus.publish(TF_STATIC, {"transforms": [fixed]}, latched=True)

    def step(self) -> None:
        """Say where the robot is, if somebody listens."""
        self._seq += 1
        if self._graph.bus.has_subscribers(TF):
            here = self._robot.odometry_pose
            frames = [(MAP_FRAME, ODOM_FRAME, _ORIGIN), (ODOM_FRAME, BASE_FRAME, here)]
            transforms = [
                self._transform(
                    parent, child, {"x": pose.x, "y": pose.y, "z": 0.0}, yaw_rotation(pose.theta)
                )
                for parent, child, pose in frames
            ]
            self._graph.bus.publish(TF, {"transforms": transforms})

    def _transform(self, parent: str, child: str, position: Values, turn: Values) -> Values:
        return {
            "header": self._graph.types.header(parent, time.time_ns(), self._seq),
            "child_frame_id": child,
            "transform": {"translation": position, "rotation": turn},
        }
