"""publish: a message from a client goes to all subscribers of its topic, the client itself included.

A topic that the client did not advertise is advertised on the way, as the real rosbridge does.
"""

import time
from typing import Any

from sim_robot.bus import full_name
from sim_robot.rosbridge import fields
from sim_robot.rosbridge.client import Client
from sim_robot.rosbridge.operations.advertise import register


def publish(client: Client, operation: dict[str, Any]) -> None:
    """Check the message against the topic's type, fill it up and hand it on."""
    topic = full_name(fields.text(operation, "topic"))
    type_name = fields.optional_text(operation, "type")
    values = fields.optional_object(operation, "msg") or {}
    bus, types = client.graph.bus, client.graph.types
    if topic not in client.advertised:
        register(client, topic, type_name, fields.identity(operation))
    elif type_name is not None:
        bus.advertise(topic, type_name, client.node)  # refuses another type
    key = bus.type_key(topic)
    if key is not None and bus.has_subscribers(topic):
        bus.publish(topic, types.conform(key, values, time.time_ns()))
    elif key is not None:
        types.conform(key, values, time.time_ns())
