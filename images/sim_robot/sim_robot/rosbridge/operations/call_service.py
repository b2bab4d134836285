"""call_service: a client calls a service of the robot and gets a service_response.

A call that fails is answered with `result` false and the reason in `values`.
"""

import time
from typing import Any

from sim_robot.bus import full_name
from sim_robot.graph import Graph
from sim_robot.problems import SimRobotProblem
from sim_robot.rosbridge import fields
from sim_robot.rosbridge.client import Client


def call_service(client: Client, operation: dict[str, Any]) -> None:
    """Call the service and queue its response."""
    name = fields.text(operation, "service")
    answer: dict[str, Any] = {"op": "service_response", "service": name}
    try:
        values = _call(client.graph, name, operation.get("args"))
    except SimRobotProblem as problem:
        client.reply(answer | {"values": str(problem), "result": False}, fields.identity(operation))
    else:
        client.reply(answer | {"values": values, "result": True}, fields.identity(operation))


def _call(graph: Graph, name: str, args: object) -> dict[str, Any]:
    service = graph.services.get(full_name(name))
    if isinstance(args, list):
        args = dict(zip((field for field, _ in service.request), args, strict=False))
    given = args if isinstance(args, dict) else {}
    what = graph.types.name_of(service.key, "srv")
    request = graph.types.conform_fields(what, service.request, given, time.time_ns())
    return service.handler(request)
