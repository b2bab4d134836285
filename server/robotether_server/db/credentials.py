"""What clients log in with: logins of browsers and API tokens of programs.

A client keeps a secret text, the database only its SHA-256. A plain hash is enough, as each text holds 32 random
bytes; nobody can try them all. Written by services; the relay reads the views relay_logins and relay_tokens.
"""

import datetime as dt
import hashlib
import secrets
from dataclasses import dataclass
from typing import Literal

from robotether_server.db import users
from robotether_server.db.database import Transaction, unique
from robotether_server.db.users import User
from robotether_server.problems import RecordMissingError, TokenInvalidError
from robotether_server.schemas import Label, Timestamp, UserName

RANDOM_BYTES = 32
API_PREFIX = "rt_"
# Minimum interval between updates of a login's last use.
RENEWED_EVERY = dt.timedelta(minutes=1)
# What alone a token is for, if not for all that its user may do.
TokenUse = Literal["metrics"]
SELECT_TOKENS = (
    "SELECT t.id, u.name AS user, t.name, t.created_at, t.expires_at, t.only_for "
    "FROM api_tokens t JOIN users u ON u.id = t.user_id "
)


def new_secret(prefix: str = "") -> str:
    """Return a new secret in URL-safe base64, after the prefix."""
    return prefix + secrets.token_urlsafe(RANDOM_BYTES)


def digest(text: str) -> bytes:
    """Return the value of the column token_hash for this text.

    Headers and JSON may hold halves of characters, as which bytes over 0x7F are read: no text of ours has any.
    """
    return hashlib.sha256(text.encode(errors="surrogatepass")).digest()


@dataclass(frozen=True)
class Lifetime:
    """How long a login lasts: in all, and after its last use."""

    total: dt.timedelta
    idle: dt.timedelta

    @property
    def unused(self) -> dt.timedelta:
        """How long a login lasts that nobody uses at all."""
        return min(self.total, self.idle)


def create_login(tx: Transaction, user: User, address: str, lifetime: dt.timedelta) -> str:
    """Log a user in; return the text for the cookie. Also forgets logins that are over."""
    text = new_secret()
    tx.change("DELETE FROM logins WHERE expires_at <= CURRENT_TIMESTAMP(6)")
    tx.insert(
        "INSERT INTO logins (token_hash, user_id, address, expires_at) VALUES (%s, %s, %s, %s)",
        (digest(text), user.id, address, tx.now() + lifetime),
    )
    return text


def find_login_user(tx: Transaction, text: str) -> User | None:
    """Return the enabled user whose valid login this is."""
    row = tx.row(
        users.SELECT + "JOIN logins l ON l.user_id = u.id "
        "WHERE l.token_hash = %s AND l.expires_at > CURRENT_TIMESTAMP(6) AND NOT u.disabled",
        (digest(text),),
    )
    return users.from_row(row) if row else None


def login_renewal(tx: Transaction, text: str, lifetime: Lifetime) -> dt.datetime | None:
    """Return until when a login lasts by its use now; None when that is what its row says, or nearly so."""
    row = tx.row(
        "SELECT created_at, expires_at, CURRENT_TIMESTAMP(6) AS now FROM logins WHERE token_hash = %s",
        (digest(text),),
    )
    if row is None:
        return None
    ends_at = min(row["created_at"] + lifetime.total, row["now"] + lifetime.idle)
    return ends_at if ends_at - row["expires_at"] > RENEWED_EVERY else None


def renew_login(tx: Transaction, text: str, ends_at: dt.datetime) -> None:
    """Extend a login that has not ended."""
    tx.change(
        "UPDATE logins SET expires_at = %s WHERE token_hash = %s AND expires_at > CURRENT_TIMESTAMP(6)",
        (ends_at, digest(text)),
    )


def end_login(tx: Transaction, text: str) -> bool:
    """Log out; return whether there was such a login."""
    return bool(tx.change("DELETE FROM logins WHERE token_hash = %s", (digest(text),)))


def end_logins(tx: Transaction, user_id: int) -> int:
    """Log a user out everywhere; return how many logins ended."""
    return tx.change("DELETE FROM logins WHERE user_id = %s", (user_id,))


@dataclass(frozen=True)
class Token:
    """An API token without its text, which only its creator knows.

    It may do what its user may do, or `only_for` says what alone it is for.
    """

    id: int
    user: UserName
    name: Label
    created_at: Timestamp
    expires_at: Timestamp | None
    only_for: TokenUse | None


def _token_hash(text: str, only_for: TokenUse | None) -> bytes:
    """Return the hash of a token; one that is for something alone is not found by its text."""
    return digest(text if only_for is None else f"{only_for} {text}")


def create_token(
    tx: Transaction,
    user: User,
    name: str,
    expires_at: dt.datetime | None,
    only_for: TokenUse | None = None,
) -> str:
    """Make a token; return its text, which cannot be had again. Raises RecordExistsError."""
    text = new_secret(API_PREFIX)
    with unique(
        f"cannot create token {name}: user {user.name} has one of that name; delete it or choose another name"
    ):
        tx.insert(
            "INSERT INTO api_tokens (user_id, name, token_hash, expires_at, only_for) VALUES (%s, %s, %s, %s, %s)",
            (user.id, name, _token_hash(text, only_for), expires_at, only_for),
        )
    return text


def get_token_user(tx: Transaction, text: str) -> User:
    """Return the enabled user whose valid token of all rights this is; raise TokenInvalidError."""
    user = find_token_user(tx, text)
    if user is None:
        raise TokenInvalidError(
            "cannot accept the token: it is unknown, expired or its user disabled"
        )
    return user


def find_token_user(tx: Transaction, text: str, only_for: TokenUse | None = None) -> User | None:
    """Return the enabled user whose valid token this is, of all rights, or for this alone."""
    row = tx.row(
        users.SELECT + "JOIN api_tokens t ON t.user_id = u.id WHERE t.token_hash = %s "
        "AND (t.expires_at IS NULL OR t.expires_at > CURRENT_TIMESTAMP(6)) AND NOT u.disabled",
        (_token_hash(text, only_for),),
    )
    return users.from_row(row) if row else None


def list_tokens(tx: Transaction) -> list[Token]:
    """Return every token, by user and name."""
    return [Token(**row) for row in tx.rows(SELECT_TOKENS + "ORDER BY u.name, t.name")]


def list_tokens_of(tx: Transaction, user: User) -> list[Token]:
    """Return the user's tokens, by name."""
    rows = tx.rows(SELECT_TOKENS + "WHERE t.user_id = %s ORDER BY t.name", (user.id,))
    return [Token(**row) for row in rows]


def get_token(tx: Transaction, token_id: int, owner: User | None = None) -> Token:
    """Return the token of that id, if it is this owner's; raise RecordMissingError."""
    row = tx.row(SELECT_TOKENS + "WHERE t.id = %s", (token_id,))
    if row is None or (owner is not None and row["user"] != owner.name):
        raise RecordMissingError(f"cannot find token {token_id}: there is none of that number")
    return Token(**row)


def delete_token(tx: Transaction, token_id: int) -> None:
    """Delete a token."""
    tx.change("DELETE FROM api_tokens WHERE id = %s", (token_id,))
