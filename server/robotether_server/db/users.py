"""Users: who may log in. Written by services; read by web."""

from dataclasses import dataclass, field
from typing import Literal

from robotether_server.db.database import Row, Transaction
from robotether_server.problems import RecordExists, RecordMissing

Role = Literal["admin", "user"]
ROLES: tuple[Role, ...] = ("admin", "user")

SELECT = "SELECT u.id, u.name, u.role, u.disabled, u.password_hash FROM users u "


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


def from_row(row: Row) -> User:
    """Make a user of a row of SELECT."""
    return User(
        id=row["id"],
        name=row["name"],
        role=row["role"],
        disabled=bool(row["disabled"]),
        password_hash=row["password_hash"],
    )


def find(tx: Transaction, name: str) -> User | None:
    """Return the user of that name, disabled or not."""
    row = tx.row(SELECT + "WHERE u.name = %s", (name,))
    return from_row(row) if row else None


def get(tx: Transaction, name: str) -> User:
    """Return the user of that name; raise RecordMissing."""
    user = find(tx, name)
    if user is None:
        raise RecordMissing(f"cannot find user {name}: no such user; add one with: user add {name}")
    return user


def add(tx: Transaction, name: str, password_hash: str, role: Role) -> int:
    """Add a user; return the id. Raises RecordExists or RecordRefused."""
    try:
        return tx.insert(
            "INSERT INTO users (name, password_hash, role) VALUES (%s, %s, %s)",
            (name, password_hash, role),
        )
    except RecordExists as error:
        raise RecordExists(f"cannot add user {name}: the name is taken") from error


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
