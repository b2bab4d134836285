"""API tokens: what programs of a user log in with."""

import datetime as dt

from robotether_server import schemas
from robotether_server.db import Transaction, audit, tokens
from robotether_server.db.audit import Event, Source
from robotether_server.db.tokens import Token
from robotether_server.db.users import User
from robotether_server.field_types import Label
from robotether_server.problems import NotPossible

# So that no user fills the table, nor the lists of admins.
MAX_TOKENS = 1000


def create(
    tx: Transaction, source: Source, user: User, name: str, expires_at: dt.datetime | None
) -> str:
    """Make a token and return its text, which cannot be had again.

    Raises FieldInvalid, RecordExists or NotPossible.
    """
    schemas.check("name", name, Label)
    if len(tokens.list_of(tx, user)) >= MAX_TOKENS:
        raise NotPossible(
            f"cannot create token {name}: user {user.name} has {MAX_TOKENS}; delete those that are not used"
        )
    text = tokens.create(tx, user, name, expires_at)
    details: dict[str, object] = {
        "user": user.name,
        "token": name,
        "expires_at": expires_at.isoformat(timespec="seconds") if expires_at else None,
    }
    audit.record(tx, source, Event("token_created", details=details))
    return text


def get(tx: Transaction, token_id: int) -> Token:
    """Return one token, so that the caller can check its owner; raise RecordMissing."""
    return tokens.get(tx, token_id)


def delete(tx: Transaction, source: Source, token_id: int) -> Token:
    """Delete a token and return it; what it opened ends. Raises RecordMissing."""
    token = tokens.get(tx, token_id)
    tokens.delete(tx, token_id)
    details: dict[str, object] = {"user": token.user, "token": token.name}
    audit.record(tx, source, Event("token_deleted", details=details))
    return token


def list_all(tx: Transaction) -> list[Token]:
    """Return every token, by user and name."""
    return tokens.list_all(tx)


def list_of(tx: Transaction, user: User) -> list[Token]:
    """Return the user's tokens, by name."""
    return tokens.list_of(tx, user)
