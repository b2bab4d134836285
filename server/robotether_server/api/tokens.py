"""/api/v1/tokens: API tokens; the user's own, and all for admins. /api/v1/join-tokens: tokens that admit robots."""

import datetime as dt
from dataclasses import dataclass
from typing import Annotated

from flask import request
from msgspec import UNSET, Meta, Struct, UnsetType

from robotether_server.api import auth
from robotether_server.api.auth import Caller
from robotether_server.api.context import context
from robotether_server.api.operations import Created, operation
from robotether_server.db import credentials, join_tokens, users
from robotether_server.db.credentials import Token, TokenUse
from robotether_server.db.join_tokens import JoinToken, Place
from robotether_server.db.users import User
from robotether_server.install_line import enrolment_lines
from robotether_server.problems import StoreUnavailableError
from robotether_server.schemas import Label, UserName
from robotether_server.services import tokens as token_service
from robotether_server.settings.robot import Region


class NewToken(Struct, forbid_unknown_fields=True):
    """A new API token; without `days` it ends after a year.

    With `only_for` it does nothing else: one of an admin that is for metrics alone reads them and has no other right.
    """

    name: Label
    days: Annotated[int, Meta(ge=1, le=token_service.MAX_DAYS)] | UnsetType = UNSET
    user: UserName | UnsetType = UNSET
    only_for: TokenUse | UnsetType = UNSET


@dataclass(frozen=True)
class CreatedToken(Token):
    """An API token with its text, which is shown once."""

    token: str


class TokenList(Struct):
    """Tokens, by user and name."""

    tokens: list[Token]


class NewJoinToken(Struct, forbid_unknown_fields=True):
    """A new join token: how many robots it admits, for how long, and where they belong.

    Users of `group` may drive them.
    """

    name: Label
    uses: Annotated[int, Meta(ge=1, le=token_service.MAX_USES)]
    hours: Annotated[int, Meta(ge=1, le=token_service.MAX_HOURS)]
    site: Label | UnsetType = UNSET
    group: Label | UnsetType = UNSET
    region: Region | UnsetType = UNSET


@dataclass(frozen=True)
class CreatedJoinToken(JoinToken):
    """A join token with its text and the install line, which are shown once.

    `warning`: why no robot can use the line, or empty.
    """

    token: str
    command: str
    warning: str


class JoinTokenList(Struct):
    """Join tokens, newest first."""

    join_tokens: list[JoinToken]


@operation("GET", "/tokens", "user")
def list_tokens(caller: Caller) -> TokenList:
    """List the user's API tokens, without their texts; for admins everybody's."""
    if caller.user.is_admin:
        return TokenList(credentials.list_tokens(caller.tx))
    return TokenList(credentials.list_tokens_of(caller.tx, caller.user))


@operation("POST", "/tokens", "user", problems=(404, 409))
def create_token(caller: Caller, body: NewToken) -> Created[CreatedToken]:
    """Create an API token for the user; an admin may name another user. A login does this, an API token may not."""
    owner = _owner(caller, body.user or caller.user.name)
    text = token_service.create(
        caller.tx,
        caller.source,
        owner,
        body.name,
        body.days or None,
        only_for=body.only_for or None,
    )
    # A name is unique among the user's tokens.
    [token] = [
        token for token in credentials.list_tokens_of(caller.tx, owner) if token.name == body.name
    ]
    return CreatedToken(**vars(token), token=text), 201


@operation("DELETE", "/tokens/<int:token_id>", "user")
def delete_token(caller: Caller, token_id: int) -> None:
    """Delete an API token of the user, with the join tokens and SSH keys that it made; an admin may delete any."""
    credentials.get_token(caller.tx, token_id, None if caller.user.is_admin else caller.user)
    token_service.delete(caller.tx, caller.source, token_id)


def _owner(caller: Caller, name: str) -> User:
    if name == caller.user.name:
        return caller.user
    auth.check_admin(caller.user)
    return users.get(caller.tx, name)


@operation("GET", "/join-tokens", "admin")
def list_join_tokens(caller: Caller) -> JoinTokenList:
    """List join tokens, without their texts."""
    return JoinTokenList(join_tokens.list_all(caller.tx))


@operation("POST", "/join-tokens", "admin", problems=(404, 409))
def create_join_token(caller: Caller, body: NewJoinToken) -> Created[CreatedJoinToken]:
    """Create a token that admits robots, and the line that installs one."""
    expires_at = caller.tx.now() + dt.timedelta(hours=body.hours)
    place = Place(body.site or None, body.group or None, body.region or None)
    text = token_service.create_join_token(
        caller.tx, caller.source, body.name, body.uses, expires_at, place=place
    )
    join_token = join_tokens.find(caller.tx, text)
    if join_token is None:
        raise StoreUnavailableError("cannot make the join token: it is gone already; try again")
    # This may raise: without an install line there is no token.
    lines = enrolment_lines(context().site_certificates, request.host, text)
    return CreatedJoinToken(
        **vars(join_token), token=text, command=lines.install, warning=lines.warning
    ), 201


@operation("DELETE", "/join-tokens/<int:token_id>", "admin")
def delete_join_token(caller: Caller, token_id: int) -> None:
    """Delete the token; robots that it admitted stay."""
    token_service.delete_join_token(caller.tx, caller.source, token_id)
