"""The services of a robot that its SSH connections forward to the server: one row each.

A service's port stands in a robot's row, in the API and in the session's configuration as `NAME_port`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from robotether_common.session import Kind

ServiceName = Literal["ros", "video", "shell"]


@dataclass(frozen=True)
class ForwardedService:
    """One service, and the kind of the SSH connection that forwards it."""

    name: ServiceName
    connection: Kind
    # Whether a robot can be without a port for it.
    is_optional: bool = False

    @property
    def port_member(self) -> str:
        """The name of the member that has its port."""
        return f"{self.name}_port"


# rosbridge behind the guard, cameras behind the video proxy, and the robot's own sshd.
SERVICES = (
    ForwardedService("ros", "session"),
    ForwardedService("video", "media"),
    ForwardedService("shell", "shell", is_optional=True),
)
BY_CONNECTION = {service.connection: service for service in SERVICES}
