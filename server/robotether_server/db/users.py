"""Users: who may log in; and their SSH public keys, by which they reach the shells of robots.

Written by services, read by web. sshd's account `jump` reads the keys of robots' managers through the view jump_keys.
"""

from dataclasses import dataclass, field
from typing import Literal

from robotether_server.db.database import Row, Transaction, unique
from robotether_server.identity import PublicKey
from robotether_server.problems import RecordExistsError, RecordMissingError
from robotether_server.schemas import Fingerprint, Label, Timestamp

Role = Literal["admin", "user"]
ROLES: tuple[Role, ...] = ("admin", "user")

SELECT = "SELECT u.id, u.name, u.role, u.disabled, u.password_hash FROM users u "
SELECT_SSH_KEY = "SELECT id, name, fingerprint, public_key, created_at FROM user_ssh_keys "


@dataclass(frozen=True)
class User:
    """One user; the password is an argon2 hash."""

    id: int
    name: str
    role: Role
    disabled: bool
    password_hash: str = field(repr=False)

    @property
    def is_admin(self) -> bool:
        """Admins manage every robot."""
        return self.role == "admin"


@dataclass(frozen=True)
class SshKey:
    """One key; `public_key` is `TYPE BASE64`."""

    id: int
    name: Label
    fingerprint: Fingerprint
    public_key: str
    created_at: Timestamp


def from_row(row: Row) -> User:
    """Make a user of a row of SELECT."""
    return User(**row | {"disabled": bool(row["disabled"])})


def find(tx: Transaction, name: str) -> User | None:
    """Return the user of that name, disabled or not."""
    row = tx.row(SELECT + "WHERE u.name = %s", (name,))
    return from_row(row) if row else None


def get(tx: Transaction, name: str) -> User:
    """Return the user of that name; raise RecordMissingError."""
    user = find(tx, name)
    if user is None:
        raise RecordMissingError(f"cannot find user {name}: no such user; see the list of users")
    return user


def add(tx: Transaction, name: str, password_hash: str, role: Role) -> int:
    """Add a user; return the id. Raises RecordExistsError or RecordRefusedError."""
    with unique(f"cannot add user {name}: the name is taken"):
        return tx.insert(
            "INSERT INTO users (name, password_hash, role) VALUES (%s, %s, %s)",
            (name, password_hash, role),
        )


def is_unchanged(tx: Transaction, user: User) -> bool:
    """Return whether the user still has this password and is enabled; it stays so until the transaction ends."""
    row = tx.row(
        "SELECT 1 FROM users WHERE id = %s AND password_hash = %s AND NOT disabled LOCK IN SHARE MODE",
        (user.id, user.password_hash),
    )
    return row is not None


def set_password(tx: Transaction, user_id: int, password_hash: str) -> None:
    """Replace the password and end every login made with the old one."""
    tx.change("UPDATE users SET password_hash = %s WHERE id = %s", (password_hash, user_id))
    tx.change("DELETE FROM logins WHERE user_id = %s", (user_id,))


def list_all(tx: Transaction) -> list[User]:
    """Return every user, by name."""
    return [from_row(row) for row in tx.rows(SELECT + "ORDER BY u.name")]


def set_disabled(tx: Transaction, user_id: int, *, disabled: bool) -> None:
    """Disable a user, which ends the logins, or enable the user again."""
    tx.change("UPDATE users SET disabled = %s WHERE id = %s", (disabled, user_id))
    if disabled:
        tx.change("DELETE FROM logins WHERE user_id = %s", (user_id,))


def set_role(tx: Transaction, user_id: int, role: Role) -> None:
    """Make a user an admin, or an admin a user."""
    tx.change("UPDATE users SET role = %s WHERE id = %s", (role, user_id))


def remove(tx: Transaction, user_id: int) -> None:
    """Remove a user with logins, tokens, keys and grants."""
    tx.change("DELETE FROM users WHERE id = %s", (user_id,))


def enabled_admins(tx: Transaction) -> list[str]:
    """Return the names of those who can administer this site, locked until the transaction ends."""
    rows = tx.rows("SELECT name FROM users WHERE role = 'admin' AND NOT disabled FOR UPDATE")
    return [row["name"] for row in rows]


def ssh_keys_made_by(tx: Transaction, api_token_id: int) -> list[int]:
    """Return the ids of those that an API token added."""
    rows = tx.rows("SELECT id FROM user_ssh_keys WHERE api_token_id = %s", (api_token_id,))
    return [row["id"] for row in rows]


def add_ssh_key(
    tx: Transaction, user: User, name: str, key: PublicKey, api_token: bytes | None = None
) -> SshKey:
    """Add a key; raise RecordExistsError when the user has it, or one of that name.

    `api_token` is the hash of the one that adds it.
    """
    try:
        key_id = tx.insert(
            "INSERT INTO user_ssh_keys (user_id, name, fingerprint, public_key, api_token_id) "
            "VALUES (%s, %s, %s, %s, (SELECT id FROM api_tokens WHERE token_hash = %s))",
            (user.id, name, key.fingerprint, key.line, api_token),
        )
    except RecordExistsError as error:
        duplicate = "a key of that name" if error.key == "user_ssh_keys_name" else "this very key"
        raise RecordExistsError(
            f"cannot add SSH key {name}: user {user.name} has {duplicate} already", error.key
        ) from error
    return get_ssh_key(tx, user, key_id)


def get_ssh_key(tx: Transaction, user: User, key_id: int) -> SshKey:
    """Return a key of that user; raise RecordMissingError."""
    row = tx.row(SELECT_SSH_KEY + "WHERE user_id = %s AND id = %s", (user.id, key_id))
    if row is None:
        raise RecordMissingError(
            f"cannot find SSH key {key_id}: user {user.name} has none of that number"
        )
    return SshKey(**row)


def list_ssh_keys(tx: Transaction, user: User) -> list[SshKey]:
    """Return the user's keys, by name."""
    rows = tx.rows(SELECT_SSH_KEY + "WHERE user_id = %s ORDER BY name", (user.id,))
    return [SshKey(**row) for row in rows]


def delete_ssh_key(tx: Transaction, key_id: int) -> None:
    """Delete a key."""
    tx.change("DELETE FROM user_ssh_keys WHERE id = %s", (key_id,))
