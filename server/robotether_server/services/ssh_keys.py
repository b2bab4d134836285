"""People's SSH public keys, for shells on the robots that they manage."""

from robotether_server import schemas, ssh_keys
from robotether_server.db import Transaction, audit, users
from robotether_server.db.audit import Event, Source
from robotether_server.db.users import SshKey, User
from robotether_server.field_types import MAX_NAME_LENGTH, Label
from robotether_server.problems import NotPossible

MAX_KEYS = 20


def add(tx: Transaction, source: Source, user: User, name: str | None, line: str) -> SshKey:
    """Add a key; without a name it gets its comment's. Raises FieldInvalid, RecordExists or NotPossible."""
    key = ssh_keys.parse_persons(line)
    chosen = name or ssh_keys.comment(line)[:MAX_NAME_LENGTH].strip() or key.fingerprint
    schemas.check("name", chosen, Label)
    if len(users.list_ssh_keys(tx, user)) >= MAX_KEYS:
        raise NotPossible(
            f"cannot add SSH key {chosen}: user {user.name} has {MAX_KEYS}; delete one that is not used"
        )
    added = users.add_ssh_key(tx, user, chosen, key)
    audit.record(tx, source, Event("ssh_key_added", details=_details(user, added)))
    return added


def list_of(tx: Transaction, user: User) -> list[SshKey]:
    """Return the user's keys, by name."""
    return users.list_ssh_keys(tx, user)


def delete(tx: Transaction, source: Source, user: User, key_id: int) -> SshKey:
    """Delete a key of this user and return it; what it opened ends. Raises RecordMissing."""
    key = users.get_ssh_key(tx, user, key_id)
    users.delete_ssh_key(tx, key.id)
    audit.record(tx, source, Event("ssh_key_deleted", details=_details(user, key)))
    return key


def _details(user: User, key: SshKey) -> dict[str, object]:
    return {"user": user.name, "key": key.name, "fingerprint": key.fingerprint}
