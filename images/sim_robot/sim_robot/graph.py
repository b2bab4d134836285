"""The simulated robot's ROS graph: topics and services, inside this one process.

Made once by simulator.py and handed to everything that publishes, subscribes or offers a service. A topic exists as
long as somebody advertises it or subscribes to it. Must never wait: a subscriber's callback is called at once and has
to return at once.
"""

import logging
import re
from collections.abc import Callable
from dataclasses import dataclass, field

from sim_robot.messages import Fields, MessageTypes, SimRobotError, Values

log = logging.getLogger(__name__)

_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+", re.ASCII)
NAME_LIMIT = 255


class GraphError(SimRobotError):
    """The topic or service is not what the caller believes."""


@dataclass(frozen=True, eq=False)
class Node:
    """One participant. Several may have one name, as all clients of rosbridge do."""

    name: str


@dataclass(frozen=True, eq=False)
class TopicMessage:
    """One published message; `wire` keeps what it was encoded to, by the topic's name there."""

    topic: str
    key: str
    values: Values
    wire: dict[str, str] = field(default_factory=dict)


Callback = Callable[[TopicMessage], None]


@dataclass(eq=False)
class _BusTopic:
    key: str
    publishers: set[Node] = field(default_factory=set)
    subscribers: dict[Node, Callback] = field(default_factory=dict)
    latched: TopicMessage | None = None


def full_name(name: str) -> str:
    """Make a topic's or service's name absolute; GraphError if ROS would not take it."""
    absolute = name if name.startswith("/") else "/" + name
    if len(absolute) > NAME_LIMIT or not _NAME.fullmatch(absolute):
        raise GraphError(
            f"cannot use the name {name!r:.80}: parts of letters, digits and _ are allowed,"
            " divided by /, none beginning with a digit"
        )
    return absolute


class Bus:
    """All topics. Nodes are told apart by identity, topics by absolute name."""

    def __init__(self, types: MessageTypes) -> None:
        self._types = types
        self._topics: dict[str, _BusTopic] = {}

    def advertise(self, topic: str, type_name: str | None, node: Node) -> None:
        """Announce that `node` publishes; without a type the topic must exist already."""
        self._establish(topic, type_name).publishers.add(node)

    def unadvertise(self, topic: str, node: Node) -> None:
        """Take that back."""
        if topic in self._topics:
            self._topics[topic].publishers.discard(node)
            self._forget_if_unused(topic)

    def subscribe(self, topic: str, type_name: str | None, node: Node, callback: Callback) -> None:
        """Call `callback` for each message from now on; one subscription a node and topic."""
        self._establish(topic, type_name).subscribers[node] = callback

    def unsubscribe(self, topic: str, node: Node) -> None:
        """End that."""
        if topic in self._topics:
            self._topics[topic].subscribers.pop(node, None)
            self._forget_if_unused(topic)

    def has_subscribers(self, topic: str) -> bool:
        """Tell whether a message would reach anybody."""
        return topic in self._topics and bool(self._topics[topic].subscribers)

    def publish(self, topic: str, values: Values, *, latched: bool = False) -> None:
        """Hand a whole message of the topic's type to all subscribers; a latched one is kept for those to come."""
        message = TopicMessage(topic, self._topics[topic].key, values)
        if latched:
            self._topics[topic].latched = message
        self.repeat(message)

    def repeat(self, message: TopicMessage) -> None:
        """Hand a message to all subscribers of its topic, without encoding again what was encoded before."""
        for callback in tuple(self._topics[message.topic].subscribers.values()):
            _deliver(callback, message)

    def latched(self, topic: str) -> TopicMessage | None:
        """Give the message that a new subscriber gets at once, if there is one."""
        return self._topics[topic].latched if topic in self._topics else None

    def type_key(self, topic: str) -> str | None:
        """Give the type of a topic, None if it does not exist."""
        return self._topics[topic].key if topic in self._topics else None

    def topics(self) -> dict[str, str]:
        """Give all topics with their types' keys, by name."""
        return {name: self._topics[name].key for name in sorted(self._topics)}

    def publisher_names(self, topic: str) -> list[str]:
        """Name the nodes that publish on a topic."""
        topic_state = self._topics.get(topic)
        return sorted({node.name for node in topic_state.publishers}) if topic_state else []

    def subscriber_names(self, topic: str) -> list[str]:
        """Name the nodes that listen to a topic."""
        topic_state = self._topics.get(topic)
        return sorted({node.name for node in topic_state.subscribers}) if topic_state else []

    def _establish(self, topic: str, type_name: str | None) -> _BusTopic:
        topic_state = self._topics.get(topic)
        if type_name is None:
            if topic_state is None:
                raise GraphError(
                    f"cannot find the type of {topic}: nobody advertises it yet; give a type"
                )
            return topic_state
        key = self._types.key_of(type_name)
        if topic_state is None:
            topic_state = self._topics[topic] = _BusTopic(key)
        elif topic_state.key != key:
            established = self._types.name_of(topic_state.key)
            raise GraphError(
                f"cannot use {topic} as {type_name}: it is established as {established}"
            )
        return topic_state

    def _forget_if_unused(self, topic: str) -> None:
        if not self._topics[topic].publishers and not self._topics[topic].subscribers:
            del self._topics[topic]


def _deliver(callback: Callback, message: TopicMessage) -> None:
    try:
        callback(message)
    except Exception:
        # The border between nodes: one that fails must not keep others from the message.
        log.exception("a subscriber of %s failed", message.topic)


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
        """Find a service, or raise GraphError."""
        if name not in self._services:
            raise GraphError(f"Service {name} does not exist")
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
