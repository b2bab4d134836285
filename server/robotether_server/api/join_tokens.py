"""/api/v1/join-tokens: tokens that admit robots, each with its install line."""

import datetime as dt
from dataclasses import dataclass
from typing import Annotated

from flask import request
from msgspec import Meta, Struct

from robotether_server.api.auth import Caller
from robotether_server.api.context import context
from robotether_server.api.operations import Created, operation
from robotether_server.db import join_tokens
from robotether_server.db.join_tokens import JoinToken
from robotether_server.field_types import Label
from robotether_server.install_line import install_line
from robotether_server.problems import StoreUnavailable
from robotether_server.services import join_tokens as join_token_service

MAX_HOURS = 8760


class NewJoinToken(Struct, forbid_unknown_fields=True):
    """A new join token: how many robots it admits, and for how long."""

    name: Label
    uses: Annotated[int, Meta(ge=1, le=join_token_service.MAX_USES)]
    hours: Annotated[int, Meta(ge=1, le=MAX_HOURS)]


@dataclass(frozen=True)
class CreatedJoinToken(JoinToken):
    """A join token with its text and the install line, which are shown once."""

    token: str
    command: str


class JoinTokenList(Struct):
    """Join tokens, newest first."""

    join_tokens: list[JoinToken]


@operation("GET", "/join-tokens", "admin")
def list_join_tokens(caller: Caller) -> JoinTokenList:
    """List join tokens, without their texts."""
    return JoinTokenList(join_token_service.list_all(caller.tx))


@operation("POST", "/join-tokens", "admin", problems=(409,))
def create_join_token(caller: Caller, body: NewJoinToken) -> Created[CreatedJoinToken]:
    """Create a token that admits robots, and the line that installs one."""
    expires_at = dt.datetime.now(dt.UTC) + dt.timedelta(hours=body.hours)
    text = join_token_service.create(caller.tx, caller.source, body.name, body.uses, expires_at)
    made = join_tokens.find(caller.tx, text)
    if made is None:
        raise StoreUnavailable("cannot make the join token: it is gone already; try again")
    # This may raise: without an install line there is no token.
    command = install_line(context().site_certificates, request.host, text)
    return CreatedJoinToken(**vars(made), token=text, command=command), 201


@operation("DELETE", "/join-tokens/<int:token_id>", "admin")
def delete_join_token(caller: Caller, token_id: int) -> None:
    """Delete the token; robots that it admitted stay."""
    join_token_service.delete(caller.tx, caller.source, token_id)
