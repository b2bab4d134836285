"""/api/v1/robots/NAME/...: what admins change of a robot's key and ports."""

from collections.abc import Callable
from dataclasses import asdict
from http import HTTPStatus

from flask import Response, jsonify, request

from robotether_server.api import auth, fields
from robotether_server.api.blueprint import blueprint
from robotether_server.api.objects import plain, robot_object
from robotether_server.db import Transaction, control_states, robots
from robotether_server.db.audit import Source
from robotether_server.db.robots import Robot
from robotether_server.services import pending
from robotether_server.services import robots as robot_service

MAX_FINGERPRINT_LENGTH = 64


@blueprint.post("/robots/<robot>/approve")
def approve_key(robot: str) -> Response:
    """Let a waiting key in: the one that is named, whatever came since."""
    return _done(robot, lambda tx, source: robot_service.approve(tx, source, robot, _fingerprint()))


@blueprint.post("/robots/<robot>/reject")
def reject_key(robot: str) -> tuple[str, int]:
    """Turn a waiting key away; a robot that nobody announced goes with it."""
    with auth.admin() as caller:
        robot_service.reject(caller.tx, caller.source, robot, _fingerprint())
    return "", HTTPStatus.NO_CONTENT


@blueprint.post("/robots/<robot>/rekey")
def rekey_robot(robot: str) -> Response:
    """Forget the key, and end the connection."""
    return _done(robot, lambda tx, source: robot_service.rekey(tx, source, robot))


@blueprint.post("/robots/<robot>/rotate-key")
def rotate_key(robot: str) -> Response:
    """Ask the agent for a new key."""
    return _done(robot, lambda tx, source: robot_service.rotate_key(tx, source, robot))


@blueprint.post("/robots/<robot>/move-ports")
def move_ports(robot: str) -> Response:
    """Give the robot another free pair of ports."""
    return _done(robot, lambda tx, source: robot_service.move_ports(tx, source, robot))


def _done(robot: str, do: Callable[[Transaction, Source], Robot]) -> Response:
    with auth.admin() as caller:
        do(caller.tx, caller.source)
        seen = robots.get_seen(caller.tx, robot)
        control = control_states.of_robot(caller.tx, seen.robot.id)
    return jsonify(robot_object(seen, control, for_admin=True))


def _fingerprint() -> str:
    body = fields.json_object(request, ("fingerprint",))
    return fields.text(body, "fingerprint", MAX_FINGERPRINT_LENGTH)


@blueprint.get("/pending")
def list_pending() -> Response:
    """List the keys that wait, the oldest first."""
    with auth.admin() as caller:
        waiting = pending.waiting(caller.tx)
    return jsonify({"pending": [plain(asdict(one)) for one in waiting]})


@blueprint.get("/rejected-keys")
def list_rejected_keys() -> Response:
    """List the keys that were turned away, the newest first."""
    with auth.admin() as caller:
        rejected = pending.rejected(caller.tx)
    return jsonify({"rejected_keys": [plain(asdict(one)) for one in rejected]})


@blueprint.delete("/rejected-keys/<int:key_id>")
def forgive_key(key_id: int) -> tuple[str, int]:
    """Let a key ask again."""
    with auth.admin() as caller:
        pending.forgive(caller.tx, caller.source, key_id)
    return "", HTTPStatus.NO_CONTENT
