"""The robot with a real ROS 2 graph (images/ros2_robot), which joins a stack or the demo like one from outside."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Protocol

import docker
from docker.models.containers import Container
from image_names import ensure_built, image

NAME = "ros2"


class Server(Protocol):
    """What it joins: a stack of a test, or the demo."""

    engine: docker.DockerClient

    @property
    def project(self) -> str: ...

    @property
    def https_port(self) -> int: ...

    def robotether(self, *arguments: str) -> str: ...


@contextmanager
def ros2_robot(server: Server, environment: Mapping[str, str]) -> Iterator[Container]:
    """Run it as the service NAME of the server's project; it may not have joined yet."""
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
            **environment,
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
