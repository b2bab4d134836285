"""Join tokens: made, listed and deleted by admins."""

import datetime as dt

from robotether_server import schemas
from robotether_server.db import Transaction, audit, credentials
from robotether_server.db.audit import Event, Source
from robotether_server.db.credentials import JoinToken
from robotether_server.field_types import Label
from robotether_server.problems import FieldInvalid

MAX_USES = 10000
MAX_LIFETIME = dt.timedelta(hours=8760)


def create(tx: Transaction, source: Source, name: str, uses: int, expires_at: dt.datetime) -> str:
    """Make a token and return its text, which cannot be had again; raise FieldInvalid or RecordExists."""
    schemas.check("name", name, Label)
    if not 1 <= uses <= MAX_USES:
        raise FieldInvalid(f"cannot use uses: it must be 1 to {MAX_USES}")
    lifetime = expires_at - dt.datetime.now(dt.UTC)
    if not dt.timedelta() < lifetime <= MAX_LIFETIME:
        raise FieldInvalid("cannot use hours: the token's time must end within 1 to 8760 hours")
    text = credentials.create_join_token(
        tx, name, uses, expires_at, source.actor[: audit.MAX_ACTOR_LENGTH]
    )
    details: dict[str, object] = {
        "token": name,
        "uses": uses,
        "expires_at": expires_at.isoformat(timespec="seconds"),
    }
    audit.record(tx, source, Event("join_token_created", details=details))
    return text


def list_all(tx: Transaction) -> list[JoinToken]:
    """Return every join token, the newest first."""
    return credentials.list_join_tokens(tx)


def delete(tx: Transaction, source: Source, token_id: int) -> JoinToken:
    """Delete a token and return it; the robots that it let in stay. Raises RecordMissing."""
    token = credentials.get_join_token(tx, token_id)
    credentials.delete_join_token(tx, token_id)
    details: dict[str, object] = {"token": token.name, "used": token.used}
    audit.record(tx, source, Event("join_token_deleted", details=details))
    return token


def delete_of(tx: Transaction, source: Source, maker: str) -> None:
    """Delete all tokens that this admin made."""
    for token in credentials.list_join_tokens(tx):
        if token.created_by == maker:
            delete(tx, source, token.id)
