"""A program of your own on a robot behind Robotether: publish on a topic and wait for the echo.

Needs `pip install roslibpy` and an API token (`robotether token create --user NAME --name laptop`):

    python roslibpy_client.py https://robots.example sim1 rt_...

Take a new ticket for every connection: a ticket opens one WebSocket, within 30 s. Its mode `drive` makes this program
the robot's driver, if nobody else drives and the robot is not stopped; `observe` is for subscribing alone. Whoever may
`drive` publishes on the drive topics, such as /cmd_vel; for any other topic, as here, it takes `manage`, or the topic
in the robot's policy. With a self-signed certificate give its file in SSL_CERT_FILE, or set ROBOTETHER_INSECURE=1 on a
network that you trust.
"""

import json
import os
import ssl
import sys
import threading
import urllib.request

import roslibpy

TRIES = 20


def get_ticket(server: str, robot: str, token: str, mode: str = "drive") -> str:
    """Ask the server for a ticket; raises urllib.error.HTTPError with a problem+json body when it refuses."""
    request = urllib.request.Request(  # noqa: S310 - the server's address comes from the caller
        f"{server}/api/v1/tickets",
        data=json.dumps({"robot": robot, "mode": mode}).encode(),
        headers={"Content-Type": "application/json", "Authorization": f"Bearer {token}"},
    )
    context = ssl.create_default_context()
    if os.environ.get("ROBOTETHER_INSECURE"):
        context = ssl._create_unverified_context()  # noqa: S323 - asked for, see above
    with urllib.request.urlopen(request, context=context, timeout=10) as answer:  # noqa: S310
        return str(json.load(answer)["ticket"])


def main() -> None:
    """Publish a text, wait for it to come back from the robot, print it."""
    server, robot, token = sys.argv[1:4]
    ticket = get_ticket(server, robot, token)
    ros = roslibpy.Ros(f"{server.replace('https', 'wss', 1)}/robots/{robot}/ros?ticket={ticket}")
    ros.run(timeout=10)
    topic = roslibpy.Topic(ros, "/robotether_hello", "std_msgs/String")
    came_back = threading.Event()

    def hear(message: dict[str, str]) -> None:
        print(message["data"])  # noqa: T201 - what this example is for
        came_back.set()

    topic.subscribe(hear)
    topic.advertise()
    for _ in range(TRIES):
        topic.publish(roslibpy.Message({"data": f"hello from {robot}"}))
        if came_back.wait(0.5):
            break
    ros.terminate()
    if not came_back.is_set():
        sys.exit(
            f"nothing came back from {robot}: does somebody drive it, or its policy refuse this?"
        )


if __name__ == "__main__":
    main()
