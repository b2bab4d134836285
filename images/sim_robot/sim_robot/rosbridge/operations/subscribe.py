"""subscribe, unsubscribe: messages of a topic go to the client.

`throttle_rate` (ms) and `queue_length` act as in the real rosbridge, `compression` may be none or cbor.
`fragment_size` is checked and has no effect. A latched message comes at once, as to each new subscriber.
"""

from functools import partial
from typing import Any

from sim_robot.bus import TopicMessage, full_name
from sim_robot.problems import OperationFieldInvalid
from sim_robot.rosbridge import encoding, fields
from sim_robot.rosbridge.client import Client
from sim_robot.rosbridge.subscription import SubscribeRequest, Subscription
from sim_robot.rosbridge.throttled_queue import ThrottledQueue


def subscribe(client: Client, operation: dict[str, Any]) -> None:
    """Add one subscription of the client to the topic."""
    as_written = fields.text(operation, "topic")
    topic = full_name(as_written)
    type_name = fields.optional_text(operation, "type")
    request = _request(operation)
    fields.count(operation, "fragment_size")
    client.check_limit()
    known = client.subscriptions.get(topic)
    subscription = known or Subscription(
        ThrottledQueue(partial(_deliver, client, topic, as_written))
    )
    client.graph.bus.subscribe(topic, type_name, client.node, subscription.offer)
    client.subscriptions[topic] = subscription
    subscription.add(fields.identity(operation), request)
    latched = client.graph.bus.latched(topic)
    if known is None and latched is not None:
        subscription.offer(latched)


def unsubscribe(client: Client, operation: dict[str, Any]) -> None:
    """End one subscription, or all to the topic when the operation has no id."""
    topic = full_name(fields.text(operation, "topic"))
    identity = fields.identity(operation)
    subscription = client.subscriptions.get(topic)
    if subscription is None:
        client.status("warning", f"unsubscribe: this client has none to {topic}", identity)
        return
    subscription.remove(identity)
    if not len(subscription):
        del client.subscriptions[topic]
        subscription.close()
        client.graph.bus.unsubscribe(topic, client.node)


def _request(operation: dict[str, Any]) -> SubscribeRequest:
    compression = fields.optional_text(operation, "compression") or encoding.NONE
    if compression not in encoding.COMPRESSIONS:
        raise OperationFieldInvalid(
            f"cannot send with compression {compression!r:.40}:"
            f" the simulated robot has {' and '.join(encoding.COMPRESSIONS)}"
        )
    return SubscribeRequest(
        throttle_ms=fields.count(operation, "throttle_rate"),
        queue_length=fields.count(operation, "queue_length"),
        compression=compression,
    )


def _deliver(client: Client, topic: str, as_written: str, message: TopicMessage) -> None:
    # The client knows the topic by the name that it wrote, which may lack the leading slash.
    client.deliver(message, as_written, client.subscriptions[topic].compression)
