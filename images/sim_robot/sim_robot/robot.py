"""The simulated robot as a ROS node: /cmd_vel in, /pose and /odom out, the service /reset.

Stepped 62.5 times a second by simulator.py. Pose and path are in the world's frame (origin in its lower
left corner), as turtlesim's; odometry is in the frame `odom`, which has its origin in the start pose, as a
real robot's has.
"""

import logging
import math
import time
from collections import deque

from sim_robot.graph import Graph, Node, Service, TopicMessage
from sim_robot.kinematics import DRIVETRAINS, Pose, Turtle
from sim_robot.messages import Values, float32

log = logging.getLogger(__name__)

NODE = Node("/sim_robot")
CMD_VEL, POSE, ODOM, RESET = "/cmd_vel", "/pose", "/odom", "/reset"
ODOM_FRAME, BASE_FRAME = "odom", "base_link"
SPEED_LIMIT = 1e6  # m/s and rad/s: beyond it floats lose the position
PATH_STEP_M = 0.05
PATH_POINTS = 2000  # 100 m: the paper's 78 m spiral fits, and memory is bounded
_COVARIANCE = [1e-6 if i % 7 == 0 else 0.0 for i in range(36)]


class RobotNode:
    """Joins the kinematics to the topics."""

    def __init__(self, graph: Graph, world_size_m: float, kind: str) -> None:
        self._graph = graph
        self._drivetrain = DRIVETRAINS[kind]
        self._seq = 0
        self._was_at_wall = False
        self.turtle = Turtle(world_size_m)
        self.path: deque[tuple[float, float]] = deque(maxlen=PATH_POINTS)
        self._remember_path()
        graph.bus.subscribe(CMD_VEL, self._drivetrain.command_type, NODE, self._on_cmd_vel)
        graph.bus.advertise(POSE, "turtlesim/Pose", NODE)
        graph.bus.advertise(ODOM, "nav_msgs/Odometry", NODE)
        graph.services.add(Service(RESET, "std_srvs/Empty", NODE.name, (), self._reset))

    def step(self) -> None:
        """Move on by one step and publish pose and odometry."""
        self.turtle.step(time.monotonic())
        self._seq += 1
        self._warn_at_wall()
        self._remember_path()
        bus = self._graph.bus
        if bus.has_subscribers(POSE):
            bus.publish(POSE, self._pose())
        if bus.has_subscribers(ODOM):
            bus.publish(ODOM, self._odometry())

    @property
    def steps(self) -> int:
        """Count the steps since the start; a reset does not set it back."""
        return self._seq

    @property
    def odometry_pose(self) -> Pose:
        """The pose in the frame `odom`."""
        pose, start = self.turtle.pose, self.turtle.start
        return Pose(pose.x - start.x, pose.y - start.y, pose.theta - start.theta)

    def _on_cmd_vel(self, message: TopicMessage) -> None:
        velocity = self._drivetrain.velocity(message.values)
        parts = (velocity.linear_x, velocity.linear_y, velocity.angular_z)
        if not all(abs(part) <= SPEED_LIMIT for part in parts):  # false for NaN too
            log.warning("ignored a command on %s that no robot can follow: %s", CMD_VEL, velocity)
            return
        self.turtle.command(velocity, time.monotonic())

    def _reset(self, _request: Values) -> Values:
        self.turtle.reset()
        self.path.clear()
        self._remember_path()
        return {}

    def _remember_path(self) -> None:
        here = (self.turtle.pose.x, self.turtle.pose.y)
        if not self.path or math.dist(self.path[-1], here) >= PATH_STEP_M:
            self.path.append(here)

    def _warn_at_wall(self) -> None:
        if self.turtle.at_wall and not self._was_at_wall:
            log.warning("hit the wall at x=%.3f y=%.3f", self.turtle.pose.x, self.turtle.pose.y)
        self._was_at_wall = self.turtle.at_wall

    def _pose(self) -> Values:
        pose, speed = self.turtle.pose, self.turtle.velocity
        return {
            "x": float32(pose.x),
            "y": float32(pose.y),
            "theta": float32(pose.theta),
            # Without a sign, as turtlesim; odometry tells forward from backward.
            "linear_velocity": float32(math.hypot(speed.linear_x, speed.linear_y)),
            "angular_velocity": float32(speed.angular_z),
        }

    def _odometry(self) -> Values:
        pose, speed = self.odometry_pose, self.turtle.velocity
        position = {"x": pose.x, "y": pose.y, "z": 0.0}
        twist = {
            "linear": {"x": speed.linear_x, "y": speed.linear_y, "z": 0.0},
            "angular": {"x": 0.0, "y": 0.0, "z": speed.angular_z},
        }
        return {
            "header": self._graph.types.header(ODOM_FRAME, time.time_ns(), self._seq),
            "child_frame_id": BASE_FRAME,
            "pose": {
                "pose": {"position": position, "orientation": yaw_rotation(pose.theta)},
                "covariance": _COVARIANCE,
            },
            "twist": {"twist": twist, "covariance": _COVARIANCE},
        }


def yaw_rotation(yaw: float) -> Values:
    """Write a turn about z as a geometry_msgs/Quaternion."""
    return {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
