"""The operations that a client may send: one function a kind, the list of all, and the border of one request.

server.py hands each message to `handle`. An operation takes the client and the whole message, and raises a
SimRobotError when it cannot be done. Errors go back to the client as rosbridge's status message and end neither the
connection nor anything else.
"""

import json
import logging
import time
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from sim_robot.graph import Graph, full_name
from sim_robot.messages import SimRobotError
from sim_robot.rosbridge.client import (
    Client,
    SubscribeRequest,
    Subscription,
    ThrottledQueue,
)

Operation = Mapping[str, Any]
T = TypeVar("T")

log = logging.getLogger(__name__)


class OperationError(SimRobotError):
    """A rosbridge operation is broken, unknown or not offered."""


def advertise(client: Client, operation: dict[str, Any]) -> None:
    """Establish the topic, if need be, and count this advertisement; `latch` and `queue_size` have no effect."""
    topic = full_name(get_text(operation, "topic"))
    type_name = get_text(operation, "type")
    _register(client, topic, type_name, get_identity(operation))


def unadvertise(client: Client, operation: dict[str, Any]) -> None:
    """Take one advertisement back, or all of the topic when the operation has no id."""
    topic = full_name(get_text(operation, "topic"))
    identity = get_identity(operation)
    if topic not in client.advertised:
        return
    held = client.advertised[topic]
    held.discard(identity)
    if identity is None or not held:
        del client.advertised[topic]
        client.graph.bus.unadvertise(topic, client.node)


def _register(
    client: Client, topic: str, type_name: str | None, identity: str | int | None
) -> None:
    """Make the client a publisher of the topic."""
    client.graph.bus.advertise(topic, type_name, client.node)
    client.advertised.setdefault(topic, set()).add(identity)


def publish(client: Client, operation: dict[str, Any]) -> None:
    """Hand a message, checked and filled up, to all subscribers of its topic, the client itself included.

    A topic that the client did not advertise is advertised on the way, as the real rosbridge does.
    """
    topic = full_name(get_text(operation, "topic"))
    type_name = get_optional_text(operation, "type")
    values = get_optional_object(operation, "msg") or {}
    bus, types = client.graph.bus, client.graph.types
    if topic not in client.advertised:
        _register(client, topic, type_name, get_identity(operation))
    elif type_name is not None:
        bus.advertise(topic, type_name, client.node)  # refuses another type
    key = bus.type_key(topic)
    if key is not None and bus.has_subscribers(topic):
        bus.publish(topic, types.conform(key, values, time.time_ns()))
    elif key is not None:
        types.conform(key, values, time.time_ns())


def subscribe(client: Client, operation: dict[str, Any]) -> None:
    """Add one subscription of the client to the topic.

    `throttle_rate` (ms) and `queue_length` act as in the real rosbridge; `compression` is none.
    A latched message comes at once, as to each new subscriber.
    """
    as_written = get_text(operation, "topic")
    topic = full_name(as_written)
    type_name = get_optional_text(operation, "type")
    request = _request(operation)
    former = client.subscriptions.get(topic)
    # The client knows the topic by the name that it wrote, which may lack the leading slash.
    subscription = former or Subscription(
        ThrottledQueue(lambda message: client.deliver(message, as_written))
    )
    client.graph.bus.subscribe(topic, type_name, client.node, subscription.offer)
    client.subscriptions[topic] = subscription
    subscription.add(get_identity(operation), request)
    latched = client.graph.bus.latched(topic)
    if former is None and latched is not None:
        subscription.offer(latched)


def unsubscribe(client: Client, operation: dict[str, Any]) -> None:
    """End one subscription, or all to the topic when the operation has no id."""
    topic = full_name(get_text(operation, "topic"))
    subscription = client.subscriptions.get(topic)
    if subscription is None:
        return
    subscription.remove(get_identity(operation))
    if not len(subscription):
        del client.subscriptions[topic]
        subscription.close()
        client.graph.bus.unsubscribe(topic, client.node)


def _request(operation: dict[str, Any]) -> SubscribeRequest:
    compression = get_optional_text(operation, "compression") or "none"
    if compression != "none":
        raise OperationError(
            f"the simulated robot cannot send with compression {compression!r:.40}"
        )
    return SubscribeRequest(
        throttle_ms=get_count(operation, "throttle_rate"),
        queue_length=get_count(operation, "queue_length"),
    )


def call_service(client: Client, operation: dict[str, Any]) -> None:
    """Queue the service's response; of a call that fails, `result` is false and `values` the reason."""
    name = get_text(operation, "service")
    answer: dict[str, Any] = {"op": "service_response", "service": name}
    try:
        values = _call(client.graph, name, operation.get("args"))
    except SimRobotError as problem:
        client.reply(answer | {"values": str(problem), "result": False}, get_identity(operation))
    else:
        client.reply(answer | {"values": values, "result": True}, get_identity(operation))


def _call(graph: Graph, name: str, args: object) -> dict[str, Any]:
    service = graph.services.get(full_name(name))
    if isinstance(args, list):
        args = dict(zip((field for field, _ in service.request), args, strict=False))
    values = args if isinstance(args, dict) else {}
    what = graph.types.name_of(service.key, "srv")
    request = graph.types.conform_fields(what, service.request, values, time.time_ns())
    return service.handler(request)


def ignore(_client: Client, _operation: dict[str, Any]) -> None:
    """Take what a client reports or sets of status messages: only errors are sent, whatever it sets."""


OPERATIONS: Mapping[str, Callable[[Client, dict[str, Any]], None]] = {
    "advertise": advertise,
    "unadvertise": unadvertise,
    "publish": publish,
    "subscribe": subscribe,
    "unsubscribe": unsubscribe,
    "call_service": call_service,
    "set_level": ignore,
    "status": ignore,
}


def handle(client: Client, data: str | bytes) -> None:
    """Do what one message asks for."""
    operation: dict[str, Any] = {}
    try:
        operation = _parse(data)
        _run(client, operation)
    except SimRobotError as problem:
        log.info("%s: %s", client.name, problem)
        _report(client, operation, str(problem))
    except Exception:
        log.exception("%s: an operation failed", client.name)
        _report(client, operation, "the simulator failed; its log has the reason")


def _run(client: Client, operation: dict[str, Any]) -> None:
    name = operation.get("op")
    if name is None:
        raise OperationError(f"Received a message without an op; known are {_names()}")
    if not isinstance(name, str) or name not in OPERATIONS:
        raise OperationError(f"Unknown operation: {name!r:.60}; known are {_names()}")
    get_identity(operation)
    OPERATIONS[name](client, operation)


def _names() -> str:
    return ", ".join(OPERATIONS)


def _parse(data: str | bytes) -> dict[str, Any]:
    try:
        operation = json.loads(data, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise OperationError(f"cannot read a message: it is not JSON ({error})") from error
    if not isinstance(operation, dict):
        raise OperationError("cannot read a message: it is JSON, but no object")
    return operation


def _refuse_constant(text: str) -> float:
    raise ValueError(f"JSON has no {text}")


def _report(client: Client, operation: dict[str, Any], text: str) -> None:
    name, identity = operation.get("op"), operation.get("id")
    prefix = f"{name}: " if isinstance(name, str) and name in OPERATIONS else ""
    status = {"op": "status", "level": "error", "msg": prefix + text}
    client.reply(status, identity if isinstance(identity, str | int) else None)


def get_text(operation: Operation, name: str) -> str:
    """Get a string that must be there."""
    value = get_optional_text(operation, name)
    if value is None:
        raise OperationError(f"Expected a {name} field but none was found")
    return value


def get_optional_text(operation: Operation, name: str) -> str | None:
    """Get a string, or None if the field is left out."""
    return _optional(operation, name, str, "a string")


def get_optional_object(operation: Operation, name: str) -> dict[str, Any] | None:
    """Get an object, or None if the field is left out."""
    return _optional(operation, name, dict, "an object")


def get_count(operation: Operation, name: str) -> int:
    """Get a whole number that is not negative, 0 if the field is left out."""
    value = operation.get(name, 0)
    if type(value) is not int or value < 0:
        raise OperationError(
            f"Expected field {name} to be a whole number from 0, not {value!r:.60}"
        )
    return value


def get_identity(operation: Operation) -> str | int | None:
    """Get the field id, None if it is left out."""
    value = operation.get("id")
    if value is None or type(value) in (str, int):
        return value
    raise OperationError(f"Expected field id to be a string or a whole number, not {value!r:.60}")


def _optional(operation: Operation, name: str, kind: type[T], what: str) -> T | None:
    value = operation.get(name)
    if name not in operation or isinstance(value, kind):
        return value
    raise OperationError(f"Expected field {name} to be {what}, not {value!r:.60}")
