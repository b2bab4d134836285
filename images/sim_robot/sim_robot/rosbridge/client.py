"""One client of rosbridge: what it advertises, what it is subscribed to, what waits for it.

Made by server.py for each connection, changed by the operations. Knows no socket: what goes out waits
in `outbox`.
"""

from dataclasses import dataclass, field
from typing import Any

from sim_robot.bus import Node, TopicMessage
from sim_robot.graph import Graph
from sim_robot.problems import ClientLimit
from sim_robot.rosbridge import encoding
from sim_robot.rosbridge.outbox import Outbox
from sim_robot.rosbridge.subscription import Subscription

NODE_NAME = "/rosbridge_websocket"
STATUS_LEVELS = ("info", "warning", "error", "none")  # from talkative to silent
TOPICS_LIMIT = 1000

Id = str | int | None


@dataclass(eq=False)
class Client:
    """The state of one connection."""

    graph: Graph
    name: str
    outbox: Outbox = field(default_factory=Outbox)
    level: str = "error"
    advertised: dict[str, set[Id]] = field(default_factory=dict)
    subscriptions: dict[str, Subscription] = field(default_factory=dict)
    node: Node = field(default_factory=lambda: Node(NODE_NAME))

    def reply(self, message: dict[str, Any], identity: Id) -> None:
        """Queue a reply, with the id of what it answers."""
        if identity is not None:
            message["id"] = identity
        self.outbox.put_reply(encoding.to_json(message))

    def status(self, level: str, text: str, identity: Id) -> None:
        """Queue a status message, unless the client does not want to hear this level."""
        if STATUS_LEVELS.index(level) >= STATUS_LEVELS.index(self.level):
            self.reply({"op": "status", "level": level, "msg": text}, identity)

    def deliver(self, message: TopicMessage, topic: str, compression: str) -> None:
        """Queue a topic message."""
        frame = encoding.publish_frame(self.graph.types, message, topic, compression)
        self.outbox.put_message(frame)

    def check_limit(self) -> None:
        """Raise ClientLimit when the client may not hold one more topic."""
        held = sum(map(len, self.advertised.values())) + sum(map(len, self.subscriptions.values()))
        if held >= TOPICS_LIMIT:
            raise ClientLimit(f"cannot take one more topic: this client holds {TOPICS_LIMIT}")

    def close(self) -> None:
        """Give back everything that the client held."""
        for topic in self.advertised:
            self.graph.bus.unadvertise(topic, self.node)
        for topic, subscription in self.subscriptions.items():
            subscription.close()
            self.graph.bus.unsubscribe(topic, self.node)
        self.advertised.clear()
        self.subscriptions.clear()
