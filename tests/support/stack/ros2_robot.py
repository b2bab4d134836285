"""The robot with a real ROS 2 graph (images/ros2_robot), which joins a stack like one from outside."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from docker.models.containers import Container
from image_names import ensure_built, image
from stack import Stack

NAME = "ros2"


@contextmanager
def ros2_robot(server: Stack) -> Iterator[Container]:
    """Run it as the service NAME of the stack's project; it may not have joined yet."""
    ensure_built("ros2_robot")
    host = f"cloud:{server.https_port}"
    line = server.robotether("robot", "invite", "--name", NAME, "--host", host).splitlines()[-1]
    container = server.engine.containers.run(
        image("ros2_robot"),
        name=f"{server.project}-{NAME}",
        detach=True,
        labels={
            "com.docker.compose.project": server.project,
            "com.docker.compose.service": NAME,
        },
        mac_address="00:1b:44:00:52:01",
        extra_hosts={"cloud": "host-gateway"},
        read_only=True,
        tmpfs={"/run": "", "/tmp": ""},
        cap_drop=["ALL"],
        environment={
            "ROBOTETHER_SERVER": host,
            "ROBOTETHER_NAME": NAME,
            "ROBOTETHER_TOKEN": _option(line, "token"),
            "ROBOTETHER_TLS_FINGERPRINT": _option(line, "tls-fingerprint"),
            "ROBOTETHER_INTERFACE": "eth0",
        },
    )
    try:
        yield container
    finally:
        container.remove(force=True, v=True)
        server.robotether("robot", "remove", NAME, "--yes")


def _option(line: str, name: str) -> str:
    found = re.search(rf"--{name} (\S+)", line)
    assert found is not None, line
    return found[1]
