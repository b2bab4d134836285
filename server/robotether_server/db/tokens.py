"""API tokens: what programs of a user log in with. Written by services.

The relay reads them through the view relay_tokens.
"""

import datetime as dt
from dataclasses import dataclass

from robotether_server.db import digests, users
from robotether_server.db.database import Transaction
from robotether_server.db.users import User
from robotether_server.field_types import Label, Timestamp, UserName
from robotether_server.problems import RecordExists, RecordMissing

PREFIX = "rt_"
SELECT = (
    "SELECT t.id, u.name AS user, t.name, t.created_at, t.expires_at "
    "FROM api_tokens t JOIN users u ON u.id = t.user_id "
)


@dataclass(frozen=True)
class Token:
    """An API token without its text, which only its creator knows."""

    id: int
    user: UserName
    name: Label
    created_at: Timestamp
    expires_at: Timestamp | None


def create(tx: Transaction, user: User, name: str, expires_at: dt.datetime | None) -> str:
    """Make a token; return its text, which cannot be had again. Raises RecordExists."""
    text = digests.new_text(PREFIX)
    try:
        tx.insert(
            "INSERT INTO api_tokens (user_id, name, token_hash, expires_at) VALUES (%s, %s, %s, %s)",
            (user.id, name, digests.digest(text), expires_at),
        )
    except RecordExists as error:
        raise RecordExists(
            f"cannot create token {name}: user {user.name} has one of that name; "
            "delete it or choose another name"
        ) from error
    return text


def find_user(tx: Transaction, text: str) -> User | None:
    """Return the enabled user whose valid token this is."""
    row = tx.row(
        users.SELECT + "JOIN api_tokens t ON t.user_id = u.id WHERE t.token_hash = %s "
        "AND (t.expires_at IS NULL OR t.expires_at > CURRENT_TIMESTAMP(6)) AND NOT u.disabled",
        (digests.digest(text),),
    )
    return users.from_row(row) if row else None


def list_all(tx: Transaction) -> list[Token]:
    """Return every token, by user and name."""
    return [Token(**row) for row in tx.rows(SELECT + "ORDER BY u.name, t.name")]


def list_of(tx: Transaction, user: User) -> list[Token]:
    """Return the user's tokens, by name."""
    rows = tx.rows(SELECT + "WHERE t.user_id = %s ORDER BY t.name", (user.id,))
    return [Token(**row) for row in rows]


def get(tx: Transaction, token_id: int) -> Token:
    """Return the token of that id; raise RecordMissing."""
    row = tx.row(SELECT + "WHERE t.id = %s", (token_id,))
    if row is None:
        raise RecordMissing(f"cannot find token {token_id}: there is none of that number")
    return Token(**row)


def delete(tx: Transaction, token_id: int) -> None:
    """Delete a token."""
    tx.change("DELETE FROM api_tokens WHERE id = %s", (token_id,))
