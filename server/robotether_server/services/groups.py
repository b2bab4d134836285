"""Groups of users: made, filled and removed by admins."""

from robotether_server import schemas
from robotether_server.db import Transaction, audit, groups, users
from robotether_server.db.audit import Event, Source
from robotether_server.db.groups import Group
from robotether_server.field_types import NewPlainName
from robotether_server.problems import RecordMissing


def add(tx: Transaction, source: Source, name: str) -> Group:
    """Add a group without members; raise FieldInvalid or RecordExists."""
    schemas.check("name", name, NewPlainName)
    groups.add(tx, name)
    audit.record(tx, source, Event("group_added", details={"group": name}))
    return groups.get(tx, name)


def remove(tx: Transaction, source: Source, name: str) -> Group:
    """Remove a group with its grants; return it as it was. Raises RecordMissing."""
    found = groups.get(tx, name)
    groups.remove(tx, found.id)
    details: dict[str, object] = {"group": name, "members": list(found.members)}
    audit.record(tx, source, Event("group_removed", details=details))
    return found


def add_member(tx: Transaction, source: Source, name: str, user: str) -> Group:
    """Give a user the grants of a group; raise RecordMissing. Who is a member already stays one."""
    if groups.add_member(tx, groups.get(tx, name).id, users.get(tx, user).id):
        details: dict[str, object] = {"group": name, "user": user}
        audit.record(tx, source, Event("group_member_added", details=details))
    return groups.get(tx, name)


def remove_member(tx: Transaction, source: Source, name: str, user: str) -> Group:
    """Remove a user from a group; raise RecordMissing."""
    if not groups.remove_member(tx, groups.get(tx, name).id, users.get(tx, user).id):
        raise RecordMissing(f"cannot remove user {user} from group {name}: the user is no member")
    details: dict[str, object] = {"group": name, "user": user}
    audit.record(tx, source, Event("group_member_removed", details=details))
    return groups.get(tx, name)
