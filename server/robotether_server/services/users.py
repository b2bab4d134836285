"""Users: who may log in, and who administers. The last enabled admin stays one.

The join tokens of an admin end with that role: they admit robots with that admin's rights.
"""

from robotether_server import passwords, schemas
from robotether_server.db import Transaction, audit, credentials, users
from robotether_server.db.audit import Source
from robotether_server.db.users import Role, User
from robotether_server.problems import FieldInvalidError, LastAdminError, RecordExistsError
from robotether_server.schemas import NewPlainName
from robotether_server.services import tokens

FIRST_ADMIN = "admin"
# Who acts in the audit log, and makes join tokens, but is no user.
PARTS = ("cli", "migrate", "planner", "recorder", "relay", "restore", "robot", "sshd")


def add(tx: Transaction, source: Source, name: str, password: str, role: Role) -> User:
    """Add a user; raise FieldInvalidError for the name or the password, or RecordExistsError."""
    schemas.check("name", name, NewPlainName)
    if name in PARTS:
        raise FieldInvalidError(
            f"cannot use name: {name} is a part of the server in the audit log; choose another",
            "name",
        )
    users.add(tx, name, passwords.hash_password(password), role)
    audit.record(tx, source, "user_added", user=name, role=role)
    return users.get(tx, name)


def add_first(tx: Transaction, source: Source, password: str) -> bool:
    """Add the user admin if there are no users; return whether it did. Of two concurrent calls one does."""
    if users.list_all(tx):
        return False
    try:
        add(tx, source, FIRST_ADMIN, password, "admin")
    except RecordExistsError:
        return False
    return True


def set_password(tx: Transaction, source: Source, name: str, password: str) -> None:
    """Give a user a new password and end the logins made with the old one; raise FieldInvalidError."""
    user = users.get(tx, name)
    users.set_password(tx, user.id, passwords.hash_password(password))
    audit.record(tx, source, "password_set", user=name)


def set_role(tx: Transaction, source: Source, name: str, role: Role) -> User:
    """Make a user an admin, or an admin a user; raise LastAdminError."""
    user = users.get(tx, name)
    if user.role == role:
        return user
    if role != "admin":
        _check_not_last(tx, name, f"cannot make {name} a user")
        tokens.delete_join_tokens_of(tx, source, name)
    users.set_role(tx, user.id, role)
    audit.record(tx, source, "user_role_set", user=name, was=user.role, role=role)
    return users.get(tx, name)


def set_disabled(tx: Transaction, source: Source, name: str, *, disabled: bool) -> User:
    """Disable a user, or enable the user again; raise LastAdminError."""
    user = users.get(tx, name)
    if user.disabled == disabled:
        return user
    if disabled:
        _check_not_last(tx, name, f"cannot disable user {name}")
        tokens.delete_join_tokens_of(tx, source, name)
    users.set_disabled(tx, user.id, disabled=disabled)
    kind = "user_disabled" if disabled else "user_enabled"
    audit.record(tx, source, kind, user=name)
    return users.get(tx, name)


def log_out_everywhere(tx: Transaction, source: Source, name: str) -> int:
    """End all logins of a user; return how many there were. API tokens stay."""
    ended = credentials.end_logins(tx, users.get(tx, name).id)
    audit.record(tx, source, "logins_ended", user=name, logins=ended)
    return ended


def remove(tx: Transaction, source: Source, name: str) -> User:
    """Remove a user with logins, tokens, keys and grants; return the user. Raises LastAdminError."""
    user = users.get(tx, name)
    _check_not_last(tx, name, f"cannot remove user {name}")
    tokens.delete_join_tokens_of(tx, source, name)
    users.remove(tx, user.id)
    audit.record(tx, source, "user_removed", user=name, role=user.role)
    return user


def _check_not_last(tx: Transaction, name: str, action: str) -> None:
    # Locked, so that two admins who remove each other at once do not both succeed.
    if users.enabled_admins(tx) == [name]:
        raise LastAdminError(
            f"{action}: nobody else is an admin who is enabled; make another user an admin first"
        )
