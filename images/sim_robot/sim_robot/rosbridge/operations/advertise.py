"""advertise, unadvertise: a client announces that it publishes on a topic, and takes that back.

`latch` and `queue_size` are checked and have no effect here.
"""

from typing import Any

from sim_robot.bus import full_name
from sim_robot.rosbridge import fields
from sim_robot.rosbridge.client import Client


def advertise(client: Client, operation: dict[str, Any]) -> None:
    """Establish the topic, if need be, and count this advertisement."""
    topic = full_name(fields.text(operation, "topic"))
    type_name = fields.text(operation, "type")
    fields.optional_flag(operation, "latch")
    register(client, topic, type_name, fields.identity(operation))


def unadvertise(client: Client, operation: dict[str, Any]) -> None:
    """Take one advertisement back, or all of the topic when the operation has no id."""
    topic = full_name(fields.text(operation, "topic"))
    identity = fields.identity(operation)
    if topic not in client.advertised:
        client.status("warning", f"unadvertise: {topic} is not advertised by this client", identity)
        return
    held = client.advertised[topic]
    held.discard(identity)
    if identity is None or not held:
        del client.advertised[topic]
        client.graph.bus.unadvertise(topic, client.node)


def register(client: Client, topic: str, type_name: str | None, identity: str | int | None) -> None:
    """Make the client a publisher of the topic."""
    client.check_limit()
    client.graph.bus.advertise(topic, type_name, client.node)
    client.advertised.setdefault(topic, set()).add(identity)
