"""/api/v1/users: who may log in; for admins."""

from http import HTTPStatus

from flask import Response, jsonify, request

from robotether_server import passwords
from robotether_server.api import auth, fields
from robotether_server.api.auth import Caller
from robotether_server.api.blueprint import blueprint
from robotether_server.api.fields import Fields
from robotether_server.api.objects import user_object
from robotether_server.db import users
from robotether_server.db.users import ROLES
from robotether_server.field_types import MAX_NAME_LENGTH
from robotether_server.problems import FieldInvalid
from robotether_server.services import users as user_service

MEMBERS = ("name", "role", "password")
CHANGES = ("role", "disabled", "password")


@blueprint.get("/users")
def list_users() -> Response:
    """List the users."""
    with auth.admin() as caller:
        found = users.list_all(caller.tx)
    return jsonify({"users": [user_object(one) for one in found]})


@blueprint.post("/users")
def add_user() -> tuple[Response, int]:
    """Add a user; a password that is made here is told this one time."""
    with auth.admin() as caller:
        body = fields.json_object(request, MEMBERS)
        name = fields.text(body, "name", MAX_NAME_LENGTH)
        role = fields.choice(body, "role", ROLES)
        password = fields.secret(body, "password") if "password" in body else None
        given = password if password is not None else passwords.new_password()
        added = user_service.add(caller.tx, caller.source, name, given, role)
    password_once = {} if password is not None else {"password": given}
    return jsonify(user_object(added) | password_once), HTTPStatus.CREATED


@blueprint.get("/users/<user>")
def show_user(user: str) -> Response:
    """Show one user."""
    with auth.admin() as caller:
        return jsonify(user_object(users.get(caller.tx, user)))


@blueprint.patch("/users/<user>")
def change_user(user: str) -> Response:
    """Change what is given, all or nothing."""
    with auth.admin() as caller:
        body = fields.json_object(request, CHANGES)
        if not body:
            raise FieldInvalid(f"cannot change user {user}: give one of {', '.join(CHANGES)}")
        _change(caller, user, body)
        return jsonify(user_object(users.get(caller.tx, user)))


@blueprint.delete("/users/<user>")
def remove_user(user: str) -> tuple[str, int]:
    """Remove the user with grants, tokens and keys."""
    with auth.admin() as caller:
        user_service.remove(caller.tx, caller.source, user)
    return "", HTTPStatus.NO_CONTENT


@blueprint.delete("/users/<user>/logins")
def log_out_everywhere(user: str) -> tuple[str, int]:
    """End all logins of the user."""
    with auth.admin() as caller:
        user_service.log_out_everywhere(caller.tx, caller.source, user)
    return "", HTTPStatus.NO_CONTENT


def _change(caller: Caller, user: str, body: Fields) -> None:
    tx, source = caller.tx, caller.source
    if "role" in body:
        user_service.set_role(tx, source, user, fields.choice(body, "role", ROLES))
    if "disabled" in body:
        user_service.set_disabled(tx, source, user, disabled=fields.flag(body, "disabled"))
    if "password" in body:
        user_service.set_password(tx, source, user, fields.secret(body, "password"))


@blueprint.get("/me")
def me() -> Response:
    """Tell who asks."""
    with auth.any_user() as caller:
        return jsonify({"name": caller.user.name, "role": caller.user.role})
