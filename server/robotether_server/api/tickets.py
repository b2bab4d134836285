"""/api/v1/tickets: permissions to open one WebSocket, which the relay verifies by itself."""

from http import HTTPStatus

from flask import Response, jsonify, request

from robotether_server.api import auth, fields
from robotether_server.api.blueprint import blueprint
from robotether_server.api.context import context
from robotether_server.db import grants, robots
from robotether_server.field_types import MAX_NAME_LENGTH
from robotether_server.problems import GrantMissing, RobotUnknown
from robotether_server.tickets import MODES, Ticket, new_id

MEMBERS = ("robot", "mode")


@blueprint.post("/tickets")
def create_ticket() -> tuple[Response, int]:
    """Sign a ticket for one WebSocket to one robot, if the user's grant includes the mode."""
    with context().database.transaction() as tx:
        user = auth.api_user(tx, request)
        body = fields.json_object(request, MEMBERS, any_type=True)
        name = fields.text(body, "robot", MAX_NAME_LENGTH)
        mode = fields.choice(body, "mode", MODES)
        seen = robots.find_seen(tx, user, name)
    if seen is None:
        raise RobotUnknown(f"cannot open robot {name}: there is none of that name that you may see")
    if not grants.includes(seen.level, mode):
        raise GrantMissing(f"cannot open robot {name} to {mode}: your grant is {seen.level}")
    signer = context().signer
    kind, sha256 = auth.credential_of(request)
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
