"""What all nodes of the simulated robot share: message types, topics, services.

Made once by simulator.py and handed to everything that publishes, subscribes or offers a service.
"""

from collections.abc import Callable
from dataclasses import dataclass

from sim_robot.bus import Bus
from sim_robot.messages import Fields, MessageTypes, Values
from sim_robot.problems import ServiceUnknown

# Gets its whole request and returns its whole answer; it must not wait.
Handler = Callable[[Values], Values]


@dataclass(frozen=True, slots=True)
class Service:
    """One service; `key` is its type in the short form, as `std_srvs/Empty`."""

    name: str
    key: str
    node: str
    request: Fields
    handler: Handler


class Services:
    """All services, by name."""

    def __init__(self) -> None:
        self._services: dict[str, Service] = {}

    def add(self, service: Service) -> None:
        """Offer a service."""
        self._services[service.name] = service

    def get(self, name: str) -> Service:
        """Find a service, or raise ServiceUnknown."""
        if name not in self._services:
            raise ServiceUnknown(f"Service {name} does not exist")
        return self._services[name]

    def all(self) -> list[Service]:
        """Give all services, sorted by name."""
        return [self._services[name] for name in sorted(self._services)]


@dataclass(frozen=True, slots=True)
class Graph:
    """The simulated robot's ROS graph."""

    types: MessageTypes
    bus: Bus
    services: Services


def make_graph(ros_version: int) -> Graph:
    """Make an empty graph."""
    types = MessageTypes(ros_version)
    return Graph(types, Bus(types), Services())
