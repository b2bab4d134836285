"""Which rosbridge operations an operator's connection may send to a robot, and the bytes it sends.

`bridge` asks for every message from a client, and sends what this returns and nothing else. So what
was checked and what is sent are one: a driver may send all operations, its bytes go on as they
came, and nothing is read from them; of an observer a message is written anew, of the fields that
were checked. Who checks drivers' messages one day must write them anew in the same way.

The bytes of an observer must never go on. rosbridge, when it cannot parse a message as a whole,
runs any object with an `op` that it finds inside; what this parser reads and the robot's does not
(nesting, large numbers, NaN) would hide a `publish` in a `subscribe`.

A refusal is a sentence for the client, in rosbridge's own `status` operation, and the connection
goes on. Messages from the robot never come here.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Literal

from robotether_server.relay import fields
from robotether_server.relay.fields import Check, FieldRefusedError

Mode = Literal["observe", "drive"]
Fields = Mapping[str, Check]

# Parsing holds up everybody else, for some 4 ms at this size. A driver's larger message is none of
# the small ones that steer, and looking at its ends tells enough.
PARSED_UP_TO_BYTES = 64 * 1024
MAX_SPACE_AROUND = 64

# Services of rosapi that only look something up.
ROSAPI_LOOKUPS = tuple(
    f"/rosapi/{name}"
    for name in (
        "action_feedback_details",
        "action_goal_details",
        "action_result_details",
        "action_servers",
        "action_type",
        "get_param",
        "get_param_names",
        "get_ros_version",
        "get_time",
        "has_param",
        "interfaces",
        "message_details",
        "node_details",
        "nodes",
        "publishers",
        "search_param",
        "service_host",
        "service_node",
        "service_providers",
        "service_request_details",
        "service_response_details",
        "service_type",
        "services",
        "services_for_type",
        "subscribers",
        "topic_type",
        "topics",
        "topics_and_raw_types",
        "topics_for_type",
    )
)
LEVELS = ("info", "warning", "error", "none")
COMPRESSIONS = ("none", "png", "cbor", "cbor-raw")
LONGEST_THROTTLE_MS = 3_600_000
LONGEST_QUEUE = 1000
LONGEST_CALL_S = 60.0
# Smaller pieces would make the robot write many messages of one.
FRAGMENT_BYTES = (4096, 2**31 - 1)

_ANSWER: Fields = {
    "fragment_size": fields.whole(*FRAGMENT_BYTES),
    "compression": fields.choice(*COMPRESSIONS),
}
# The fields of each operation that an observer may send. Others are left out: rosbridge takes
# `message_intervall` from any message, and would wait so long before everything that it sends.
OBSERVER_OPERATIONS: Mapping[str, Fields] = {
    "subscribe": {
        "id": fields.identity,
        "topic": fields.text,
        "type": fields.text,
        "throttle_rate": fields.whole(0, LONGEST_THROTTLE_MS),
        "queue_length": fields.whole(0, LONGEST_QUEUE),
        "qos": fields.scalars,
        **_ANSWER,
    },
    "unsubscribe": {"id": fields.identity, "topic": fields.text},
    "call_service": {
        "id": fields.identity,
        "service": fields.choice(*ROSAPI_LOOKUPS),
        "args": fields.scalars,
        "timeout": fields.number(0, LONGEST_CALL_S),
        **_ANSWER,
    },
    "status": {"id": fields.identity, "level": fields.choice(*LEVELS), "msg": fields.text},
    "set_level": {"id": fields.identity, "level": fields.choice(*LEVELS)},
}
NEEDED_FIELDS: Mapping[str, str] = {
    "subscribe": "topic",
    "unsubscribe": "topic",
    "call_service": "service",
}


class RefusedError(Exception):
    """The message may not go to the robot; `answer` is the status message for the client."""

    def __init__(self, why: str, message_id: object = None) -> None:
        super().__init__(why)
        self.answer = status_error(why, message_id)


class NotJsonError(ValueError):
    """A text message that is no JSON object; the text says why."""


def checked_text(data: bytes, mode: Mode) -> bytes:
    """Return the bytes that may go to the robot; RefusedError when none may."""
    try:
        if mode == "drive" and len(data) > PARSED_UP_TO_BYTES:
            _look_at_ends(data)
            return data
        message = _parse(data, unique_keys=mode == "observe")
    except NotJsonError as problem:
        raise RefusedError(f"cannot read message: not JSON: {problem}") from problem
    return data if mode == "drive" else _written_for_observer(message)


def checked_binary(data: bytes, mode: Mode) -> bytes:
    """Return a driver's binary (BSON, CBOR) message; RefusedError for an observer's."""
    if mode == "drive":
        return data
    raise RefusedError("cannot pass message: an observing connection sends JSON text only")


def status_error(text: str, message_id: object) -> bytes:
    """Build rosbridge's status message; `message_id` is the id of the message it answers."""
    status: dict[str, object] = {"op": "status", "level": "error"}
    if isinstance(message_id, (str, int)):
        status["id"] = message_id
    status["msg"] = text
    return json.dumps(status).encode()


def _written_for_observer(message: Mapping[str, Any]) -> bytes:
    """Write the message anew, of its known fields; a field that is null counts as absent."""
    operation, message_id = message.get("op"), message.get("id")
    if not isinstance(operation, str) or operation not in OBSERVER_OPERATIONS:
        why = "an observing connection may not send this operation"
        raise RefusedError(f"cannot pass {_shown(operation)}: {why}", message_id)
    written: dict[str, object] = {"op": operation}
    for name, check in OBSERVER_OPERATIONS[operation].items():
        if message.get(name) is None and name != NEEDED_FIELDS.get(operation):
            continue
        try:
            written[name] = check(message.get(name))
        except FieldRefusedError as exc:
            # A long list of what is allowed would hide what is wrong.
            raise RefusedError(
                f"cannot pass {operation}: its field {name} {_reason(name, exc)}", message_id
            ) from exc
    return json.dumps(written, separators=(",", ":"), allow_nan=False).encode()


def _reason(name: str, error: FieldRefusedError) -> str:
    if name == "service":
        return "is no look-up of /rosapi, and an observing connection calls no other service"
    return str(error)


def _shown(operation: object) -> str:
    return operation[:64] if isinstance(operation, str) else "a message without op"


def _look_at_ends(data: bytes) -> None:
    try:
        data.decode()
    except UnicodeDecodeError as exc:
        raise NotJsonError("it is not UTF-8") from exc
    begin, end = data[:MAX_SPACE_AROUND].lstrip(), data[-MAX_SPACE_AROUND:].rstrip()
    if not (begin.startswith(b"{") and end.endswith(b"}")):
        raise NotJsonError("it is no object")


def _parse(data: bytes, *, unique_keys: bool) -> dict[str, Any]:
    try:
        message = json.loads(data.decode(), object_pairs_hook=_unique_keys if unique_keys else None)
    except NotJsonError:
        raise
    except RecursionError as exc:
        raise NotJsonError("it is nested too deep") from exc
    except ValueError as exc:
        raise NotJsonError(str(exc)) from exc
    if not isinstance(message, dict):
        raise NotJsonError("it is no object")
    return message


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) != len(pairs):
        raise NotJsonError("a key stands in it twice")
    return result
