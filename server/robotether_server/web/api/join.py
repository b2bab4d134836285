"""/api/v1/join: what a robot asks at its first start, and whenever it is not let in."""

from http import HTTPStatus

from flask import Response, jsonify, request

from robotether_server import macs, ssh_keys
from robotether_server.store.robots import Report, Robot
from robotether_server.web import access, fields, host_keys, joining
from robotether_server.web.api.blueprint import blueprint
from robotether_server.web.parts import parts

LONGEST_MAC = 17
LONGEST_HOSTNAME = 253
LONGEST_VERSION = 32
LONGEST_TOKEN = 200
SSH_USER = "tunnel"


@blueprint.post("/join")
def join() -> tuple[Response, int]:
    """Let a robot in, or note that it waits."""
    body = fields.json_object(request)
    token = fields.optional_text(body, "token", LONGEST_TOKEN)
    mac = macs.normalise(fields.text(body, "mac", LONGEST_MAC))
    key = ssh_keys.parse(fields.text(body, "public_key", ssh_keys.LONGEST_LINE))
    report = Report(
        hostname=fields.text(body, "hostname", LONGEST_HOSTNAME),
        agent_version=fields.text(body, "agent_version", LONGEST_VERSION),
        address=request.remote_addr or "",
    )
    with parts().database.transaction() as tx:
        approver = access.token_user(tx, token) if token else None
        asked = joining.Request(mac, key, report, approver)
        robot = joining.join(tx, asked, parts().join.max_pending)
    if robot.state == "active":
        return jsonify(_joined(robot)), HTTPStatus.OK
    return jsonify(_pending(robot)), HTTPStatus.ACCEPTED


def _joined(robot: Robot) -> dict[str, object]:
    settings = parts().join
    ssh = {
        "user": SSH_USER,
        "host": settings.public_host,
        "ports": list(settings.ssh_ports),
        "host_keys": host_keys.read(settings.ssh_host_keys_dir),
    }
    return {"state": "active", "robot": robot.name, "ssh": ssh}


def _pending(robot: Robot) -> dict[str, object]:
    return {
        "state": "pending",
        "robot": robot.name,
        "code": "approval_pending",
        "detail": f"robot {robot.name} waits for approval; an admin approves it with: "
        f"robotether robot approve {robot.name}",
    }
