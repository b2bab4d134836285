"""The services of the simulated robot: a name, a request, an answer at once.

Stands in for ROS services. A handler gets its whole request and returns its whole answer; it must not wait.
"""

from collections.abc import Callable
from dataclasses import dataclass

from sim_robot.messages import Fields, Values
from sim_robot.problems import ServiceUnknown

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
