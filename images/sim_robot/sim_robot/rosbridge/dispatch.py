"""Takes what a client sent apart and runs the operation; the border of one request.

Called by server.py for each message. Errors go back to the client as rosbridge's status message and end
neither the connection nor anything else.
"""

import json
import logging
from typing import Any

from sim_robot.problems import MessageBroken, OperationUnknown, SimRobotProblem
from sim_robot.rosbridge import fields
from sim_robot.rosbridge.client import Client
from sim_robot.rosbridge.operations import OPERATIONS

log = logging.getLogger(__name__)


def handle(client: Client, data: str | bytes) -> None:
    """Do what one message asks for."""
    operation: dict[str, Any] = {}
    try:
        operation = _parse(data)
        _run(client, operation)
    except SimRobotProblem as problem:
        log.info("%s: %s: %s", client.name, problem.code, problem)
        _report(client, operation, str(problem))
    except Exception:
        log.exception("%s: an operation failed", client.name)
        _report(client, operation, "the simulator failed; its log has the reason")


def _run(client: Client, operation: dict[str, Any]) -> None:
    name = operation.get("op")
    if name is None:
        raise OperationUnknown(f"Received a message without an op; known are {_known()}")
    if not isinstance(name, str) or name not in OPERATIONS:
        raise OperationUnknown(f"Unknown operation: {name!r:.60}; known are {_known()}")
    fields.identity(operation)
    OPERATIONS[name](client, operation)


def _known() -> str:
    return ", ".join(OPERATIONS)


def _parse(data: str | bytes) -> dict[str, Any]:
    try:
        operation = json.loads(data, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise MessageBroken(f"cannot read a message: it is no JSON ({error})") from error
    if not isinstance(operation, dict):
        raise MessageBroken("cannot read a message: it is JSON, but no object")
    return operation


def _refuse_constant(text: str) -> float:
    raise ValueError(f"JSON has no {text}")


def _report(client: Client, operation: dict[str, Any], text: str) -> None:
    name, identity = operation.get("op"), operation.get("id")
    prefix = f"{name}: " if isinstance(name, str) and name in OPERATIONS else ""
    client.status("error", prefix + text, identity if isinstance(identity, str | int) else None)
