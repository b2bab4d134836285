"""A robot with a real ROS 2 graph: nodes of rclpy in a world of the simulated robot's, and a rosbridge server for them.

Started by the simulated robot's entrypoint, in place of the simulator. Ends with its rosbridge, or by SIGTERM.
"""

from __future__ import annotations

import math
import subprocess
import sys
import time

import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import BatteryState, CompressedImage, LaserScan
from sim_robot.camera import Scene, draw, jpeg
from sim_robot.kinematics import STEP_S, Turtle, Velocity
from sim_robot.world import World
from std_srvs.srv import Trigger
from test_msgs.action import Fibonacci

WORLD_M = 20.0
ODOM_EVERY_S, SCAN_EVERY_S, FRAME_EVERY_S, BATTERY_EVERY_S = 0.05, 0.2, 0.1, 1.0
RAYS, RANGE_M = 180, 12.0
FRAME_SIZE, FRAME_QUALITY = (480, 360), 70
# Time between two numbers of a goal, so that a cancel finds it unfinished.
NUMBER_EVERY_S = 0.1
# A calibration ends once the robot has driven this far, and fails after this time.
CALIBRATION_M, CALIBRATION_S = 0.2, 30.0


class Base(Node):
    """Wheels and odometry."""

    def __init__(self) -> None:
        super().__init__("base")
        self.turtle = Turtle(WORLD_M)
        self.create_subscription(Twist, "/cmd_vel", self._on_cmd_vel, 10)
        self._odom = self.create_publisher(Odometry, "/odom", 10)
        self.create_timer(STEP_S, lambda: self.turtle.step(time.monotonic()))
        self.create_timer(ODOM_EVERY_S, self._publish)

    def now(self) -> Time:
        """The stamp of a message."""
        return self.get_clock().now().to_msg()

    def _on_cmd_vel(self, twist: Twist) -> None:
        self.turtle.command(Velocity(twist.linear.x, 0.0, twist.angular.z), time.monotonic())

    def _publish(self) -> None:
        pose, start, speed = self.turtle.pose, self.turtle.start, self.turtle.velocity
        odom = Odometry(child_frame_id="base_link")
        odom.header.frame_id, odom.header.stamp = "odom", self.now()
        odom.pose.pose.position.x = pose.x - start.x
        odom.pose.pose.position.y = pose.y - start.y
        odom.pose.pose.orientation.z = math.sin(pose.theta / 2)
        odom.pose.pose.orientation.w = math.cos(pose.theta / 2)
        odom.twist.twist.linear.x, odom.twist.twist.angular.z = speed.linear_x, speed.angular_z
        self._odom.publish(odom)


class Laser(Node):
    """A scanner in the middle of the robot; what is out of reach is infinite."""

    def __init__(self, base: Base) -> None:
        super().__init__("laser")
        self._base, self._world = base, World(WORLD_M)
        self._scan = self.create_publisher(LaserScan, "/scan", qos_profile_sensor_data)
        self.create_timer(SCAN_EVERY_S, self._publish)

    def _publish(self) -> None:
        pose, step = self._base.turtle.pose, 2 * math.pi / RAYS
        angles = [pose.theta - math.pi + ray * step for ray in range(RAYS)]
        ranges = [self._world.distance(pose.x, pose.y, angle) for angle in angles]
        scan = LaserScan(angle_min=-math.pi, angle_max=math.pi - step, angle_increment=step)
        scan.header.frame_id, scan.header.stamp = "base_link", self._base.now()
        scan.range_max = RANGE_M
        scan.ranges = [far if far <= RANGE_M else math.inf for far in ranges]
        self._scan.publish(scan)


class Camera(Node):
    """What image_transport publishes of a camera."""

    def __init__(self, base: Base) -> None:
        super().__init__("camera")
        self._base = base
        topic = "/camera/image_raw/compressed"
        self._frames = self.create_publisher(CompressedImage, topic, qos_profile_sensor_data)
        self.create_timer(FRAME_EVERY_S, self._publish)

    def _publish(self) -> None:
        if not self._frames.get_subscription_count():
            return
        turtle, now_ns = self._base.turtle, time.time_ns()
        scene = Scene("ros2", WORLD_M, turtle.pose, turtle.velocity, (), 0.0, now_ns)
        frame = CompressedImage(format="jpeg", data=jpeg(draw(scene, FRAME_SIZE), FRAME_QUALITY))
        frame.header.frame_id, frame.header.stamp = "camera", self._base.now()
        self._frames.publish(frame)


class Battery(Node):
    """Half full; its charger, its current and its second cell are not measured."""

    def __init__(self) -> None:
        super().__init__("battery")
        self._battery = self.create_publisher(BatteryState, "/battery_state", 10)
        self.create_timer(BATTERY_EVERY_S, self._publish)

    def _publish(self) -> None:
        state = BatteryState(percentage=0.5, voltage=25.2, present=True)
        state.current, state.cell_voltage = math.nan, [3.6, math.nan]
        self._battery.publish(state)


class Tasks(Node):
    """What takes its time: an action that counts until it is cancelled, and a calibration that waits for a drive."""

    def __init__(self, base: Base) -> None:
        super().__init__("tasks")
        self._base = base
        # Each call has a thread of its own.
        group = ReentrantCallbackGroup()
        self.create_service(Trigger, "/calibrate", self._calibrate, callback_group=group)
        self._count = ActionServer(
            self,
            Fibonacci,
            "/count",
            self._on_goal,
            callback_group=group,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )

    def _on_goal(self, goal: ServerGoalHandle) -> Fibonacci.Result:
        sequence = [0, 1]
        while len(sequence) < goal.request.order and not goal.is_cancel_requested:
            sequence.append(sequence[-1] + 1)
            goal.publish_feedback(Fibonacci.Feedback(sequence=sequence))
            time.sleep(NUMBER_EVERY_S)
        if goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.succeed()
        return Fibonacci.Result(sequence=sequence)

    def _calibrate(self, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        began, start = time.monotonic(), self._base.turtle.pose
        while time.monotonic() - began < CALIBRATION_S and not answer.success:
            time.sleep(STEP_S)
            here = self._base.turtle.pose
            answer.success = math.dist((here.x, here.y), (start.x, start.y)) >= CALIBRATION_M
        answer.message = "calibrated" if answer.success else "the robot did not move"
        return answer


def main() -> int:
    """Run until rosbridge ends, whose status is the answer, or a signal comes."""
    rclpy.init()
    executor = MultiThreadedExecutor(num_threads=8)
    base = Base()
    for node in (base, Laser(base), Camera(base), Battery(), Tasks(base)):
        executor.add_node(node)
    rosbridge = subprocess.Popen(["/usr/local/bin/ros2-rosbridge"])
    try:
        while rosbridge.poll() is None:
            executor.spin_once(timeout_sec=1.0)
    except (KeyboardInterrupt, ExternalShutdownException):
        rosbridge.terminate()
    return rosbridge.wait()


if __name__ == "__main__":
    sys.exit(main())
