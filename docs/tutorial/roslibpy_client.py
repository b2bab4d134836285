"""A program for a robot behind Robotether: publishes and subscribes, drives for a second, saves a frame.

Needs `pip install roslibpy` and an API token (`robotether token create --user NAME --name laptop`):

    python roslibpy_client.py https://robots.example sim1 rt_...

Get a new ticket for every connection: a ticket opens one WebSocket, within 30 s. Its mode `drive` makes this program
the robot's driver, if nobody else drives and the robot is not stopped; `observe` is for subscribing alone. Users with
level `drive` publish on the drive topics, such as /cmd_vel; any other topic, as here, needs `manage`, or the topic in
the robot's policy. With a self-signed certificate give its file in SSL_CERT_FILE, or set ROBOTETHER_INSECURE=1 on a
network that you trust. docs/reference/client.md has the same for web pages.
"""

import contextlib
import json
import os
import ssl
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from http.client import HTTPResponse
from pathlib import Path
from typing import Any

import roslibpy
from roslibpy.comm import RosBridgeClientFactory

TRIES = 20
PERIOD_S = 0.05  # the robot stops by itself when no command comes for half a second
ZEROS = 5
LONGEST_LINE = 1024


def ask(url: str, token: str, body: dict[str, Any] | None = None) -> HTTPResponse:
    """Ask the server; raises urllib.error.HTTPError with a problem+json body when it refuses."""
    request = urllib.request.Request(  # noqa: S310 - the server's address comes from the caller
        url,
        data=None if body is None else json.dumps(body).encode(),
        headers={"Content-Type": "application/json", "Authorization": f"Bearer {token}"},
    )
    context = ssl.create_default_context()
    if os.environ.get("ROBOTETHER_INSECURE"):
        context = ssl._create_unverified_context()  # noqa: S323 - asked for, see above
    answer: HTTPResponse = urllib.request.urlopen(request, context=context, timeout=10)  # noqa: S310
    return answer


def get_ticket(server: str, robot: str, token: str, mode: str = "drive") -> str:
    """Get the permission to open one connection."""
    with ask(f"{server}/api/v1/tickets", token, {"robot": robot, "mode": mode}) as answer:
        return str(json.load(answer)["ticket"])


@contextlib.contextmanager
def connected(server: str, robot: str, token: str) -> Iterator[roslibpy.Ros]:
    """Be the robot's driver for the `with` block.

    A program that connects more than once calls ros.close() here: roslibpy cannot go on after ros.terminate().
    """
    ticket = get_ticket(server, robot, token)
    # By itself roslibpy would connect again with this ticket, for ever: the server accepts it once.
    RosBridgeClientFactory.set_max_retries(0)
    ros = roslibpy.Ros(f"{server.replace('https', 'wss', 1)}/robots/{robot}/ros?ticket={ticket}")
    ros.run(timeout=10)
    try:
        yield ros
    finally:
        ros.terminate()


def echo(ros: roslibpy.Ros, text: str) -> bool:
    """Publish a text, print it when it comes back from the robot, and say whether it did."""
    topic = roslibpy.Topic(ros, "/robotether_hello", "std_msgs/String")
    came_back = threading.Event()

    def on_message(message: dict[str, str]) -> None:
        print(message["data"])  # noqa: T201 - what this example is for
        came_back.set()

    topic.subscribe(on_message)
    topic.advertise()
    for _ in range(TRIES):
        topic.publish(roslibpy.Message({"data": text}))
        if came_back.wait(0.5):
            break
    return came_back.is_set()


def drive(ros: roslibpy.Ros, forward: float, turn: float, seconds: float) -> None:
    """Drive in m/s and rad/s at 20 Hz, and end with zeros whatever happens."""
    topic = roslibpy.Topic(ros, "/cmd_vel", "geometry_msgs/Twist")
    end = time.monotonic() + seconds
    try:
        while time.monotonic() < end:
            if not ros.is_connected:
                sys.exit(
                    "the connection ended: was the robot stopped, or does somebody else drive?"
                )
            topic.publish(twist(forward, turn))
            time.sleep(PERIOD_S)
    finally:
        for _ in range(ZEROS):
            topic.publish(twist(0, 0))
            time.sleep(PERIOD_S)


def twist(forward: float, turn: float) -> roslibpy.Message:
    """Return a geometry_msgs/Twist."""
    linear, angular = {"x": forward, "y": 0, "z": 0}, {"x": 0, "y": 0, "z": turn}
    return roslibpy.Message({"linear": linear, "angular": angular})


def frames(server: str, robot: str, token: str, topic: str) -> Iterator[bytes]:
    """Yield the JPEGs of a camera, always the newest one."""
    with ask(f"{server}/robots/{robot}/video/stream?topic={topic}", token) as stream:
        length = 0
        while line := stream.readline(LONGEST_LINE):
            name, _, value = line.decode().partition(":")
            if name.lower() == "content-length":
                length = int(value)
            elif not line.strip() and length:
                yield stream.read(length)
                length = 0


def main() -> None:
    """Say hello to the robot, drive it for a second, save a frame."""
    server, robot, token = sys.argv[1:4]
    with connected(server, robot, token) as ros:
        if not echo(ros, f"hello from {robot}"):
            sys.exit(
                f"nothing came back from {robot}: does somebody drive it, or its policy refuse this?"
            )
        drive(ros, forward=0.2, turn=0.0, seconds=1.0)
    frame = next(frames(server, robot, token, "/camera/image_raw"))
    Path(f"{robot}.jpg").write_bytes(frame)


if __name__ == "__main__":
    main()
