"""The REST API under /api/v1, for pages, programs and robots. docs/protocols.md says what they agree on."""

from http import HTTPStatus

from flask import Blueprint, Response, current_app, jsonify, request

from robotether_server import macs, ssh_keys
from robotether_server.problems import GrantMissing, RobotUnknown
from robotether_server.store import grants, robots
from robotether_server.store.robots import Report, Robot, SeenRobot
from robotether_server.tickets import MODES, Ticket, new_id
from robotether_server.web import access, fields, host_keys, joining
from robotether_server.web.pages import moment_text
from robotether_server.web.parts import parts

blueprint = Blueprint("api", __name__, url_prefix="/api/v1")

LONGEST_NAME = 63
LONGEST_MAC = 17
LONGEST_HOSTNAME = 253
LONGEST_VERSION = 32
LONGEST_TOKEN = 200
SSH_USER = "tunnel"


@blueprint.get("/openapi.json")
def openapi() -> Response:
    """Describe this API."""
    with current_app.open_resource("openapi.json", "rb") as file:
        return Response(file.read(), content_type="application/json")


@blueprint.get("/me")
def me() -> Response:
    """Tell who asks."""
    with parts().database.transaction() as tx:
        user = access.api_user(tx, request)
    return jsonify({"name": user.name, "role": user.role})


@blueprint.get("/robots")
def list_robots() -> Response:
    """List the robots that the user may see."""
    with parts().database.transaction() as tx:
        seen = robots.list_seen(tx, access.api_user(tx, request))
    return jsonify({"robots": [_robot(robot) for robot in seen]})


@blueprint.post("/tickets")
def create_ticket() -> tuple[Response, int]:
    """Sign a ticket for one WebSocket to one robot, if the user's grant includes the mode."""
    with parts().database.transaction() as tx:
        user = access.api_user(tx, request)
        body = fields.json_object(request)
        name = fields.text(body, "robot", LONGEST_NAME)
        mode = fields.choice(body, "mode", MODES)
        seen = robots.find_seen(tx, user, name)
    if seen is None:
        raise RobotUnknown(f"cannot open robot {name}: there is none of that name that you may see")
    if not grants.includes(seen.level, mode):
        raise GrantMissing(f"cannot open robot {name} to {mode}: your grant is {seen.level}")
    signer = parts().signer
    kind, sha256 = access.credential_of(request)
    text = signer.sign(
        Ticket(new_id(), user.id, user.name, seen.robot.id, name, mode, kind, sha256)
    )
    ticket = {
        "ticket": text,
        "robot": name,
        "mode": mode,
        "expires_in_s": signer.ttl_s,
        "ros_url": f"/robots/{name}/ros?ticket={text}",
    }
    return jsonify(ticket), HTTPStatus.CREATED


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


def _robot(seen: SeenRobot) -> dict[str, object]:
    return {
        "name": seen.robot.name,
        "mac": seen.robot.mac,
        "state": seen.robot.state,
        "online": seen.online,
        "since": moment_text(seen.since),
        "level": seen.level,
        "ros_port": seen.robot.ros_port,
        "video_port": seen.robot.video_port,
    }


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
