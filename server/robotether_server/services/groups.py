"""Groups of users: made, filled and removed by admins."""

from robotether_server import schemas
from robotether_server.db import Transaction, audit, grants, users
from robotether_server.db.audit import Event, Source
from robotether_server.db.grants import Group
from robotether_server.field_types import NewPlainName
from robotether_server.problems import RecordMissing


def add(tx: Transaction, source: Source, name: str) -> Group:
    """Add a group without members; raise FieldInvalid or RecordExists."""
    schemas.check("name", name, NewPlainName)
    grants.add_group(tx, name)
    audit.record(tx, source, Event("group_added", details={"group": name}))
    return grants.get_group(tx, name)


def remove(tx: Transaction, source: Source, name: str) -> Group:
    """Remove a group with its grants; return it as it was. Raises RecordMissing."""
    found = grants.get_group(tx, name)
    grants.remove_group(tx, found.id)
    details: dict[str, object] = {"group": name, "members": list(found.members)}
    audit.record(tx, source, Event("group_removed", details=details))
    return found


def add_member(tx: Transaction, source: Source, name: str, user: str) -> Group:
    """Give a user the grants of a group; raise RecordMissing. Who is a member already stays one."""
    if grants.add_member(tx, grants.get_group(tx, name).id, users.get(tx, user).id):
        details: dict[str, object] = {"group": name, "user": user}
        audit.record(tx, source, Event("group_member_added", details=details))
    return grants.get_group(tx, name)


def remove_member(tx: Transaction, source: Source, name: str, user: str) -> Group:
    """Take the grants of a group away from a user; raise RecordMissing."""
    if not grants.remove_member(tx, grants.get_group(tx, name).id, users.get(tx, user).id):
        raise RecordMissing(f"cannot remove user {user} from group {name}: the user is no member")
    details: dict[str, object] = {"group": name, "user": user}
    audit.record(tx, source, Event("group_member_removed", details=details))
    return grants.get_group(tx, name)
