"""People's SSH public keys, which sshd's account `jump` accepts for the robots that they manage.

Written by services; sshd reads them through the view jump_keys.
"""

from dataclasses import dataclass

from robotether_server.db.database import Transaction
from robotether_server.db.users import User
from robotether_server.field_types import Fingerprint, Label, Timestamp
from robotether_server.problems import RecordExists, RecordMissing
from robotether_server.ssh_keys import PublicKey

SELECT = "SELECT id, name, fingerprint, public_key, created_at FROM user_ssh_keys "


@dataclass(frozen=True)
class SshKey:
    """One key; `public_key` is `TYPE BASE64`."""

    id: int
    name: Label
    fingerprint: Fingerprint
    public_key: str
    created_at: Timestamp


def add(tx: Transaction, user: User, name: str, key: PublicKey) -> SshKey:
    """Add a key; raise RecordExists when the user has it, or one of that name."""
    try:
        key_id = tx.insert(
            "INSERT INTO user_ssh_keys (user_id, name, fingerprint, public_key) VALUES (%s, %s, %s, %s)",
            (user.id, name, key.fingerprint, key.line),
        )
    except RecordExists as error:
        taken = "a key of that name" if error.key == "user_ssh_keys_name" else "this very key"
        raise RecordExists(
            f"cannot add SSH key {name}: user {user.name} has {taken} already", error.key
        ) from error
    return get(tx, user, key_id)


def get(tx: Transaction, user: User, key_id: int) -> SshKey:
    """Return a key of that user; raise RecordMissing."""
    row = tx.row(SELECT + "WHERE user_id = %s AND id = %s", (user.id, key_id))
    if row is None:
        raise RecordMissing(
            f"cannot find SSH key {key_id}: user {user.name} has none of that number"
        )
    return SshKey(**row)


def list_of(tx: Transaction, user: User) -> list[SshKey]:
    """Return the user's keys, by name."""
    rows = tx.rows(SELECT + "WHERE user_id = %s ORDER BY name", (user.id,))
    return [SshKey(**row) for row in rows]


def delete(tx: Transaction, key_id: int) -> None:
    """Delete a key."""
    tx.change("DELETE FROM user_ssh_keys WHERE id = %s", (key_id,))
