"""Which rosbridge operations an operator's connection may send to a robot.

`rosbridge` asks for every message from a client, before it goes on. A refusal is a sentence for
the client; it is answered with rosbridge's own `status` operation, and the connection goes on.
Messages from the robot never come here.

A message passes as the bytes that came. An observer's message must therefore mean the same to
every JSON parser: one with a repeated key could read `subscribe` here and `publish` on the robot.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from typing import Any, Literal

Mode = Literal["observe", "drive"]
Message = Mapping[str, Any]
# A rule returns None when an observer may send the message, else why not.
Rule = Callable[[Message], str | None]

ROSAPI_SERVICE = re.compile(r"/rosapi/[a-z_]{1,64}")
# They change the robot, so they are no look-ups.
ROSAPI_WRITES = frozenset({"/rosapi/set_param", "/rosapi/delete_param"})


class NotJsonError(ValueError):
    """A text message that is no JSON object; the text says why."""


def _free(_message: Message) -> str | None:
    return None


def _drivers_only(message: Message) -> str | None:
    return f"{message['op']} needs a drive connection, this one observes"


def _rosapi_only(message: Message) -> str | None:
    service = message.get("service")
    if not isinstance(service, str) or not ROSAPI_SERVICE.fullmatch(service):
        return "an observing connection calls services of /rosapi only"
    if service in ROSAPI_WRITES:
        return f"{service} changes the robot and needs a drive connection"
    return None


# All operations of the rosbridge v2 protocol that a client can send, and what an observer may.
OBSERVER_RULES: Mapping[str, Rule] = {
    "subscribe": _free,
    "unsubscribe": _free,
    "status": _free,
    "set_level": _free,
    "call_service": _rosapi_only,
    "advertise": _drivers_only,
    "unadvertise": _drivers_only,
    "publish": _drivers_only,
    "advertise_service": _drivers_only,
    "unadvertise_service": _drivers_only,
    "service_response": _drivers_only,
    "send_action_goal": _drivers_only,
    "cancel_action_goal": _drivers_only,
    "advertise_action": _drivers_only,
    "unadvertise_action": _drivers_only,
    "action_feedback": _drivers_only,
    "action_result": _drivers_only,
    "fragment": _drivers_only,
    "png": _drivers_only,
    "auth": _drivers_only,
}


def refusal_of_text(data: bytes, mode: Mode) -> bytes | None:
    """Return None when the message may go to the robot, else the status message to answer."""
    try:
        message = _parse(data, unique_keys=mode == "observe")
    except NotJsonError as problem:
        return status_error(f"cannot read message: not JSON: {problem}", None)
    if mode == "drive":
        return None
    return _refusal_for_observer(message)


def refusal_of_binary(mode: Mode) -> bytes | None:
    """Return None when a binary (BSON, CBOR) message may go to the robot, else the answer."""
    if mode == "drive":
        return None
    return status_error("cannot pass message: an observing connection sends JSON text only", None)


def status_error(text: str, message_id: object) -> bytes:
    """Build rosbridge's status message; `message_id` is the id of the message it answers."""
    status: dict[str, object] = {"op": "status", "level": "error"}
    if isinstance(message_id, (str, int)):
        status["id"] = message_id
    status["msg"] = text
    return json.dumps(status).encode()


def _refusal_for_observer(message: Message) -> bytes | None:
    operation = message.get("op")
    rule = OBSERVER_RULES.get(operation) if isinstance(operation, str) else None
    if rule is None:
        why: str | None = "an observing connection may not send this operation"
    else:
        why = rule(message)
    if why is None:
        return None
    return status_error(f"cannot pass {_shown(operation)}: {why}", message.get("id"))


def _shown(operation: object) -> str:
    return operation[:64] if isinstance(operation, str) else "a message without op"


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
