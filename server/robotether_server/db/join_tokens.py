"""Join tokens: each admits a number of robots until it expires. Written by services."""

import datetime as dt
from dataclasses import dataclass

from robotether_server.db import digests
from robotether_server.db.database import Row, Transaction
from robotether_server.field_types import Label, Timestamp
from robotether_server.problems import RecordExists, RecordMissing

PREFIX = "rj_"
SELECT = "SELECT id, name, uses, used, created_at, created_by, expires_at FROM join_tokens "


@dataclass(frozen=True)
class JoinToken:
    """What may be told about a join token; its text is known only to who asked for it."""

    id: int
    name: Label
    uses: int
    used: int
    created_at: Timestamp
    created_by: str
    expires_at: Timestamp


def _token(row: Row) -> JoinToken:
    return JoinToken(**row)


def create(tx: Transaction, name: str, uses: int, expires_at: dt.datetime, by: str) -> str:
    """Make a token; return its text, which cannot be had again. Raises RecordExists."""
    text = digests.new_text(PREFIX)
    try:
        tx.insert(
            "INSERT INTO join_tokens (name, token_hash, uses, expires_at, created_by) "
            "VALUES (%s, %s, %s, %s, %s)",
            (name, digests.digest(text), uses, expires_at, by),
        )
    except RecordExists as error:
        raise RecordExists(
            f"cannot create join token {name}: there is one of that name; delete it or choose another name"
        ) from error
    return text


def find(tx: Transaction, text: str) -> JoinToken | None:
    """Return the token of that text, be it used up or over."""
    row = tx.row(SELECT + "WHERE token_hash = %s", (digests.digest(text),))
    return _token(row) if row else None


def get(tx: Transaction, token_id: int) -> JoinToken:
    """Return the token of that id, locked until the transaction ends; raise RecordMissing."""
    row = tx.row(SELECT + "WHERE id = %s FOR UPDATE", (token_id,))
    if row is None:
        raise RecordMissing(f"cannot find join token {token_id}: there is none of that number")
    return _token(row)


def list_all(tx: Transaction) -> list[JoinToken]:
    """Return every join token, the newest first."""
    return [_token(row) for row in tx.rows(SELECT + "ORDER BY id DESC")]


def has_let_in(tx: Transaction, token_id: int, fingerprint: str) -> bool:
    """Tell whether this token has let that key in before."""
    found = tx.row(
        "SELECT 1 FROM join_token_uses WHERE token_id = %s AND fingerprint = %s",
        (token_id, fingerprint),
    )
    return found is not None


def use(tx: Transaction, token_id: int, fingerprint: str) -> bool:
    """Count one use, for that key; return False when none is left, its time is over or it is deleted."""
    counted = tx.change(
        "UPDATE join_tokens SET used = used + 1 "
        "WHERE id = %s AND used < uses AND expires_at > CURRENT_TIMESTAMP(6)",
        (token_id,),
    )
    if not counted:
        return False
    tx.change(
        "INSERT INTO join_token_uses (token_id, fingerprint) VALUES (%s, %s)",
        (token_id, fingerprint),
    )
    return True


def delete(tx: Transaction, token_id: int) -> None:
    """Delete a token; the robots that it let in stay."""
    tx.change("DELETE FROM join_tokens WHERE id = %s", (token_id,))
