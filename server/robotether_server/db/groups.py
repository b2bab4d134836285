"""Groups of users, whose grants each member has. Written by services."""

from dataclasses import dataclass

from robotether_server.db.database import Transaction
from robotether_server.field_types import PlainName, UserName
from robotether_server.problems import RecordExists, RecordMissing


@dataclass(frozen=True)
class Group:
    """A group and its members' names."""

    id: int
    name: PlainName
    members: tuple[UserName, ...]


def add(tx: Transaction, name: str) -> int:
    """Add a group without members; return its id. Raises RecordExists or RecordRefused."""
    try:
        return tx.insert("INSERT INTO user_groups (name) VALUES (%s)", (name,))
    except RecordExists as error:
        raise RecordExists(f"cannot add group {name}: the name is taken") from error


def get(tx: Transaction, name: str) -> Group:
    """Return the group of that name; raise RecordMissing."""
    row = tx.row("SELECT id, name FROM user_groups WHERE name = %s", (name,))
    if row is None:
        raise RecordMissing(
            f"cannot find group {name}: no such group; add one with: group add {name}"
        )
    members = tx.rows(
        "SELECT u.name FROM user_group_members m JOIN users u ON u.id = m.user_id "
        "WHERE m.group_id = %s ORDER BY u.name",
        (row["id"],),
    )
    return Group(row["id"], row["name"], tuple(member["name"] for member in members))


def list_all(tx: Transaction) -> list[Group]:
    """Return every group, by name."""
    members: dict[int, list[str]] = {}
    for row in tx.rows(
        "SELECT m.group_id, u.name FROM user_group_members m JOIN users u ON u.id = m.user_id "
        "ORDER BY u.name"
    ):
        members.setdefault(row["group_id"], []).append(row["name"])
    rows = tx.rows("SELECT id, name FROM user_groups ORDER BY name")
    return [Group(row["id"], row["name"], tuple(members.get(row["id"], ()))) for row in rows]


def remove(tx: Transaction, group_id: int) -> None:
    """Remove a group with its grants; its members stay users."""
    tx.change("DELETE FROM user_groups WHERE id = %s", (group_id,))


def add_member(tx: Transaction, group_id: int, user_id: int) -> bool:
    """Make a user a member; return whether the user was none before."""
    return bool(
        tx.change(
            "INSERT IGNORE INTO user_group_members (group_id, user_id) VALUES (%s, %s)",
            (group_id, user_id),
        )
    )


def remove_member(tx: Transaction, group_id: int, user_id: int) -> bool:
    """End a membership; return whether there was one."""
    return bool(
        tx.change(
            "DELETE FROM user_group_members WHERE group_id = %s AND user_id = %s",
            (group_id, user_id),
        )
    )
