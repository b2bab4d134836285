"""/api/v1/join-tokens: tokens that admit robots, each with its install line."""

import datetime as dt
from dataclasses import asdict
from http import HTTPStatus

from flask import Response, jsonify, request

from robotether_server.api import auth, fields
from robotether_server.api.blueprint import blueprint
from robotether_server.api.context import context
from robotether_server.api.objects import Object, plain
from robotether_server.db import Transaction, join_tokens
from robotether_server.field_types import MAX_NAME_LENGTH
from robotether_server.install_line import install_line
from robotether_server.problems import StoreUnavailable
from robotether_server.services import join_tokens as join_token_service

MAX_HOURS = 8760
MEMBERS = ("name", "uses", "hours")


@blueprint.get("/join-tokens")
def list_join_tokens() -> Response:
    """List the join tokens, without their texts."""
    with auth.admin() as caller:
        found = join_token_service.list_all(caller.tx)
    return jsonify({"join_tokens": [plain(asdict(one)) for one in found]})


@blueprint.post("/join-tokens")
def create_join_token() -> tuple[Response, int]:
    """Make a token; its text and the line are told this one time."""
    with auth.admin() as caller:
        body = fields.json_object(request, MEMBERS)
        name = fields.text(body, "name", MAX_NAME_LENGTH)
        uses = fields.number(body, "uses", 1, join_token_service.MAX_USES)
        hours = fields.number(body, "hours", 1, MAX_HOURS)
        expires_at = dt.datetime.now(dt.UTC) + dt.timedelta(hours=hours)
        text = join_token_service.create(caller.tx, caller.source, name, uses, expires_at)
        made = _token(caller.tx, text)
        # Inside: a token whose line cannot be told is not made.
        command = install_line(context().site_certificates, request.host, text)
    return jsonify(made | {"token": text, "command": command}), HTTPStatus.CREATED


@blueprint.delete("/join-tokens/<int:token_id>")
def delete_join_token(token_id: int) -> tuple[str, int]:
    """Delete a token."""
    with auth.admin() as caller:
        join_token_service.delete(caller.tx, caller.source, token_id)
    return "", HTTPStatus.NO_CONTENT


def _token(tx: Transaction, text: str) -> Object:
    found = join_tokens.find(tx, text)
    if found is None:
        raise StoreUnavailable("cannot make the join token: it is gone already; try again")
    return plain(asdict(found))
