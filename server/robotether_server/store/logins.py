"""Logins: which browser is whose. Written by web when people log in and out.

The relay reads them through the view relay_logins.
"""

import datetime as dt

from robotether_server.store import digests, users
from robotether_server.store.database import Transaction
from robotether_server.store.users import User


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


def end(tx: Transaction, text: str) -> bool:
    """Log out; return whether there was such a login."""
    return bool(tx.change("DELETE FROM logins WHERE token_hash = %s", (digests.digest(text),)))


def end_all(tx: Transaction, user_id: int) -> int:
    """Log a user out everywhere; return how many logins ended."""
    return tx.change("DELETE FROM logins WHERE user_id = %s", (user_id,))
