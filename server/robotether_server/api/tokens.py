"""/api/v1/tokens: API tokens; the user's own, and all for admins."""

import datetime as dt
from dataclasses import dataclass
from typing import Annotated

from msgspec import UNSET, Meta, Struct, UnsetType

from robotether_server.api import auth
from robotether_server.api.auth import Caller
from robotether_server.api.operations import Created, operation
from robotether_server.db import users
from robotether_server.db.tokens import Token
from robotether_server.db.users import User
from robotether_server.field_types import Label, UserName
from robotether_server.problems import RecordMissing
from robotether_server.services import tokens as token_service

MAX_DAYS = 3650


class NewToken(Struct, forbid_unknown_fields=True):
    """A new API token; without `days` it does not expire."""

    name: Label
    days: Annotated[int, Meta(ge=1, le=MAX_DAYS)] | UnsetType = UNSET
    user: UserName | UnsetType = UNSET


@dataclass(frozen=True)
class CreatedToken(Token):
    """An API token with its text, which is shown once."""

    token: str


class TokenList(Struct):
    """Tokens, by user and name."""

    tokens: list[Token]


@operation("GET", "/tokens", "user")
def list_tokens(caller: Caller) -> TokenList:
    """List the user's API tokens, without their texts; for admins everybody's."""
    if caller.user.is_admin:
        return TokenList(token_service.list_all(caller.tx))
    return TokenList(token_service.list_of(caller.tx, caller.user))


@operation("POST", "/tokens", "user", problems=(404, 409))
def create_token(caller: Caller, body: NewToken) -> Created[CreatedToken]:
    """Create an API token for the user; an admin may name another user."""
    expires_at = dt.datetime.now(dt.UTC) + dt.timedelta(days=body.days) if body.days else None
    owner = _owner(caller, body.user or caller.user.name)
    text = token_service.create(caller.tx, caller.source, owner, body.name, expires_at)
    # A name is unique among the user's tokens.
    [made] = [one for one in token_service.list_of(caller.tx, owner) if one.name == body.name]
    return CreatedToken(**vars(made), token=text), 201


@operation("DELETE", "/tokens/<int:token_id>", "user")
def delete_token(caller: Caller, token_id: int) -> None:
    """Delete an API token of the user; an admin may delete any."""
    token = token_service.get(caller.tx, token_id)
    if token.user != caller.user.name and not caller.user.is_admin:
        raise RecordMissing(f"cannot find token {token_id}: there is none of that number")
    token_service.delete(caller.tx, caller.source, token_id)


def _owner(caller: Caller, name: str) -> User:
    if name == caller.user.name:
        return caller.user
    auth.check_admin(caller.user)
    return users.get(caller.tx, name)
