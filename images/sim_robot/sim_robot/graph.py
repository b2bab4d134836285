"""What all nodes of the simulated robot share: message types, topics, services.

Made once by simulator.py and handed to everything that publishes, subscribes or offers a service.
"""

from dataclasses import dataclass

from sim_robot.bus import Bus
from sim_robot.messages import MessageTypes
from sim_robot.services import Services


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
