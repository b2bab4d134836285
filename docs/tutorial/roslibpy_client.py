"""A program for a robot behind Robotether: reads its odometry, drives for a second, saves a frame.

Needs `pip install roslibpy`, level `drive` on the robot, and an API token:

    python roslibpy_client.py https://robots.example sim1 rt_...

Get a new ticket for every connection: a ticket opens one WebSocket, within 30 s. Its mode `drive` makes this program
the robot's driver, if nobody else drives and the robot is not stopped; `observe` is for subscribing alone. With a
self-signed certificate give its file in SSL_CERT_FILE, or set ROBOTETHER_INSECURE=1 on a network that you trust.
docs/reference/client.md has the same for web pages.
"""

import contextlib
import json
import logging
import math
import os
import ssl
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from http.client import HTTPResponse
from pathlib import Path
from typing import Any

import roslibpy
from roslibpy.comm import RosBridgeClientFactory
from twisted.logger import globalLogBeginner

PERIOD_S = 0.05  # the robot stops by itself when no command comes for half a second
ZEROS = 5
MAX_LINE = 1024
TIMEOUT_S = 10


def ask(url: str, token: str, body: dict[str, Any] | None = None) -> HTTPResponse:
    """Ask the server; exits with the server's sentence when it refuses, or when it can't be reached."""
    request = urllib.request.Request(  # noqa: S310 - the server's address comes from the caller
        url,
        data=None if body is None else json.dumps(body).encode(),
        headers={"Content-Type": "application/json", "Authorization": f"Bearer {token}"},
    )
    context = ssl.create_default_context()
    if os.environ.get("ROBOTETHER_INSECURE"):
        context = ssl._create_unverified_context()  # noqa: S323 - asked for, see above
    try:
        answer: HTTPResponse = urllib.request.urlopen(request, context=context, timeout=TIMEOUT_S)  # noqa: S310
    except urllib.error.HTTPError as refused:
        sys.exit(problem_of(refused))
    except urllib.error.URLError as error:
        advice = ""
        if isinstance(error.reason, ssl.SSLCertVerificationError):
            advice = "; give the certificate in SSL_CERT_FILE, or set ROBOTETHER_INSECURE=1 on a network that you trust"
        sys.exit(f"cannot reach {url}: {error.reason}{advice}")
    return answer


def problem_of(refused: urllib.error.HTTPError) -> str:
    """Return the sentence of the server's problem+json, or the status of an answer that is not the server's."""
    with refused:
        try:
            return str(json.load(refused)["detail"])
        except (ValueError, KeyError):
            return f"the server answered {refused.code} {refused.reason}"


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
    # roslibpy has no handler for op "status", with which the server says why it refuses a message.
    ros.factory.on_ready(lambda protocol: protocol._message_handlers.update(status=print_status))
    try:
        ros.run(timeout=TIMEOUT_S)
    except TimeoutError:
        sys.exit(f"cannot connect to {robot}: no answer within {TIMEOUT_S} s")
    try:
        yield ros
    finally:
        ros.terminate()


def print_status(message: dict[str, str]) -> None:
    """Print what the server or the robot's rosbridge says of a message."""
    print(f"{message['level']}: {message['msg']}", file=sys.stderr)  # noqa: T201


class Odometry:
    """The robot's position, in metres of its odometry."""

    def __init__(self, ros: roslibpy.Ros, topic: str = "/odom") -> None:
        self._ros = ros
        self._topic = roslibpy.Topic(ros, topic, "nav_msgs/Odometry", throttle_rate=100)
        self._came = threading.Event()
        self._position = (math.nan, math.nan)
        self._topic.subscribe(self._on_message)

    def position(self) -> tuple[float, float]:
        """Return x and y of the next message."""
        self._came.clear()
        end = time.monotonic() + TIMEOUT_S
        while not self._came.wait(PERIOD_S):
            check_connection(self._ros)
            if time.monotonic() > end:
                sys.exit(f"nothing came on {self._topic.name} within {TIMEOUT_S} s")
        return self._position

    def _on_message(self, message: dict[str, Any]) -> None:
        position = message["pose"]["pose"]["position"]
        self._position = (position["x"], position["y"])
        self._came.set()


def check_connection(ros: roslibpy.Ros) -> None:
    """Exit if the connection has ended; roslibpy's log, which main() shows, has the server's reason."""
    if not ros.is_connected:
        sys.exit("the server ended the connection: see above")


def drive(ros: roslibpy.Ros, forward: float, turn: float, seconds: float) -> None:
    """Drive in m/s and rad/s at 20 Hz, and end with zeros whatever happens."""
    topic = roslibpy.Topic(ros, "/cmd_vel", "geometry_msgs/Twist")
    end = time.monotonic() + seconds
    try:
        while time.monotonic() < end:
            check_connection(ros)
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
    """Yield the JPEGs of a camera, always the newest one, until none comes in time."""
    with (
        ask(f"{server}/robots/{robot}/video/stream?topic={topic}", token) as stream,
        contextlib.suppress(TimeoutError),
    ):
        length = 0
        while line := stream.readline(MAX_LINE):
            name, _, value = line.decode().partition(":")
            if name.lower() == "content-length":
                length = int(value)
            elif not line.strip() and length:
                yield stream.read(length)
                length = 0


def main() -> None:
    """Drive the robot for a second, say how far it came, save a frame."""
    try:
        server, robot, token = sys.argv[1:]
    except ValueError:
        server = ""
    if not server.startswith("https://"):
        sys.exit(f"usage: python {sys.argv[0]} https://HOST ROBOT TOKEN")
    server = server.rstrip("/")
    logging.basicConfig(format="%(message)s")
    logging.getLogger("roslibpy").setLevel(logging.INFO)
    # Twisted logs a traceback for each message after the end of a connection, also when roslibpy's log is closed.
    logging.getLogger("twisted").disabled = True
    globalLogBeginner.beginLoggingTo([], redirectStandardIO=False)
    with connected(server, robot, token) as ros:
        odometry = Odometry(ros)
        start = odometry.position()
        drive(ros, forward=0.2, turn=0.0, seconds=1.0)
        print(f"{robot} moved {math.dist(start, odometry.position()):.2f} m")  # noqa: T201
    frame = next(frames(server, robot, token, "/camera/image_raw"), None)
    if frame is None:
        sys.exit(f"{robot}'s camera gave no frame")
    Path(f"{robot}.jpg").write_bytes(frame)
    print(f"saved a frame as {robot}.jpg")  # noqa: T201


if __name__ == "__main__":
    main()
