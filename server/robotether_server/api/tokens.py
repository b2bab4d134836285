"""/api/v1/tokens: API tokens; everybody's own, and all of them for admins."""

import datetime as dt
from dataclasses import asdict
from http import HTTPStatus

from flask import Response, jsonify, request

from robotether_server.api import auth, fields
from robotether_server.api.auth import Caller
from robotether_server.api.blueprint import blueprint
from robotether_server.api.fields import Fields
from robotether_server.api.objects import plain
from robotether_server.db import users
from robotether_server.db.users import User
from robotether_server.field_types import MAX_NAME_LENGTH
from robotether_server.problems import RecordMissing
from robotether_server.services import tokens as token_service

MAX_DAYS = 3650
MEMBERS = ("name", "days", "user")


@blueprint.get("/tokens")
def list_tokens() -> Response:
    """List the user's tokens, or everybody's for an admin, without their texts."""
    with auth.any_user() as caller:
        is_admin = caller.user.is_admin
        found = (
            token_service.list_all(caller.tx)
            if is_admin
            else token_service.list_of(caller.tx, caller.user)
        )
    return jsonify({"tokens": [plain(asdict(one)) for one in found]})


@blueprint.post("/tokens")
def create_token() -> tuple[Response, int]:
    """Make a token; its text is told this one time."""
    with auth.any_user() as caller:
        body = fields.json_object(request, MEMBERS)
        name = fields.text(body, "name", MAX_NAME_LENGTH)
        days = fields.number(body, "days", 1, MAX_DAYS) if "days" in body else None
        expires_at = dt.datetime.now(dt.UTC) + dt.timedelta(days=days) if days else None
        owner = _owner(caller, body)
        text = token_service.create(caller.tx, caller.source, owner, name, expires_at)
        # A name is a user's only once.
        [made] = [one for one in token_service.list_of(caller.tx, owner) if one.name == name]
    return jsonify(plain(asdict(made)) | {"token": text}), HTTPStatus.CREATED


@blueprint.delete("/tokens/<int:token_id>")
def delete_token(token_id: int) -> tuple[str, int]:
    """Delete a token; another user's looks like one that does not exist, but to admins."""
    with auth.any_user() as caller:
        token = token_service.get(caller.tx, token_id)
        if token.user != caller.user.name and not caller.user.is_admin:
            raise RecordMissing(f"cannot find token {token_id}: there is none of that number")
        token_service.delete(caller.tx, caller.source, token_id)
    return "", HTTPStatus.NO_CONTENT


def _owner(caller: Caller, body: Fields) -> User:
    name = fields.text(body, "user", MAX_NAME_LENGTH) if "user" in body else caller.user.name
    if name == caller.user.name:
        return caller.user
    auth.check_admin(caller.user)
    return users.get(caller.tx, name)
