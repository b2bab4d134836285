"""What a program does with roslibpy, run as a process of its own: roslibpy's event loop cannot be started twice.

`python roslibpy_round_trip.py PORT` prints one JSON object with what came back.
"""

from __future__ import annotations

import json
import sys
import threading

import roslibpy

WAIT_S = 30.0


class Collector:
    """Keeps messages and tells when there are enough."""

    def __init__(self, enough: int) -> None:
        self.messages: list[dict] = []
        self._enough = enough
        self._done = threading.Event()

    def __call__(self, message: dict) -> None:
        self.messages.append(dict(message))
        if len(self.messages) >= self._enough:
            self._done.set()

    def wait(self) -> list[dict]:
        """Wait for all of them, or give what came."""
        self._done.wait(WAIT_S)
        return self.messages


def main(port: int) -> None:
    ros = roslibpy.Ros("127.0.0.1", port)
    ros.run(WAIT_S)
    try:
        sys.stdout.write(json.dumps(look_around(ros) | round_trip(ros)))
    finally:
        ros.terminate()


def look_around(ros: roslibpy.Ros) -> dict:
    return {
        "topics": ros.get_topics(),
        "odom_type": ros.get_topic_type("/odom"),
        "twists": ros.get_topics_for_type("geometry_msgs/Twist"),
        "nodes": ros.get_nodes(),
    }


def round_trip(ros: roslibpy.Ros) -> dict:
    """Publish and subscribe, call what is there and what is not."""
    echoes, poses = Collector(20), Collector(5)
    echo = roslibpy.Topic(ros, "/echo", "std_msgs/String")
    echo.subscribe(echoes)
    # A service call on the same connection: when it is answered, the subscription is in force.
    roslibpy.Service(ros, "/reset", "std_srvs/Empty").call(
        roslibpy.ServiceRequest(), timeout=WAIT_S
    )
    for number in range(20):
        echo.publish(roslibpy.Message({"data": str(number)}))
    twist = roslibpy.Topic(ros, "/cmd_vel", "geometry_msgs/Twist")
    twist.publish(roslibpy.Message({"linear": {"x": 0.5}}))
    roslibpy.Topic(ros, "/pose", "turtlesim/Pose", throttle_rate=50).subscribe(poses)
    return {"echoes": echoes.wait(), "poses": poses.wait(), "unknown": call_unknown(ros)}


def call_unknown(ros: roslibpy.Ros) -> str:
    """Give the error of a service that does not exist."""
    service = roslibpy.Service(ros, "/nope", "std_srvs/Empty")
    try:
        service.call(roslibpy.ServiceRequest(), timeout=WAIT_S)
    except roslibpy.core.ServiceException as error:
        return str(error)
    return ""


if __name__ == "__main__":
    main(int(sys.argv[1]))
