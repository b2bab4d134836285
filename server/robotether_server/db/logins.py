"""Logins: which browser is whose. Written by web when people log in and out.

The relay reads them through the view relay_logins.
"""

import datetime as dt
from dataclasses import dataclass

from robotether_server.db import digests, users
from robotether_server.db.database import Transaction
from robotether_server.db.users import User

# So often at most a login that is used is written anew.
RENEWED_EVERY = dt.timedelta(minutes=1)


@dataclass(frozen=True)
class Lifetime:
    """How long a login lasts: in all, and after its last use."""

    total: dt.timedelta
    idle: dt.timedelta

    @property
    def unused(self) -> dt.timedelta:
        """How long a login lasts that nobody uses at all."""
        return min(self.total, self.idle)


def create(tx: Transaction, user: User, address: str, lifetime: dt.timedelta) -> str:
    """Log a user in; return the text for the cookie. Also forgets logins that are over."""
    text = digests.new_text()
    tx.change("DELETE FROM logins WHERE expires_at <= CURRENT_TIMESTAMP(6)")
    tx.insert(
        "INSERT INTO logins (token_hash, user_id, address, expires_at) VALUES (%s, %s, %s, %s)",
        (digests.digest(text), user.id, address, dt.datetime.now(dt.UTC) + lifetime),
    )
    return text


def find_user(tx: Transaction, text: str) -> User | None:
    """Return the enabled user whose valid login this is."""
    row = tx.row(
        users.SELECT + "JOIN logins l ON l.user_id = u.id "
        "WHERE l.token_hash = %s AND l.expires_at > CURRENT_TIMESTAMP(6) AND NOT u.disabled",
        (digests.digest(text),),
    )
    return users.from_row(row) if row else None


def renewal(tx: Transaction, text: str, lifetime: Lifetime) -> dt.datetime | None:
    """Return until when a login lasts by its use now; None when that is what its row says, or nearly so."""
    row = tx.row(
        "SELECT created_at, expires_at FROM logins WHERE token_hash = %s", (digests.digest(text),)
    )
    if row is None:
        return None
    ends_at = min(row["created_at"] + lifetime.total, dt.datetime.now(dt.UTC) + lifetime.idle)
    return ends_at if ends_at - row["expires_at"] > RENEWED_EVERY else None


def renew(tx: Transaction, text: str, ends_at: dt.datetime) -> None:
    """Extend a login that has not ended."""
    tx.change(
        "UPDATE logins SET expires_at = %s WHERE token_hash = %s AND expires_at > CURRENT_TIMESTAMP(6)",
        (ends_at, digests.digest(text)),
    )


def end(tx: Transaction, text: str) -> bool:
    """Log out; return whether there was such a login."""
    return bool(tx.change("DELETE FROM logins WHERE token_hash = %s", (digests.digest(text),)))


def end_all(tx: Transaction, user_id: int) -> int:
    """Log a user out everywhere; return how many logins ended."""
    return tx.change("DELETE FROM logins WHERE user_id = %s", (user_id,))
