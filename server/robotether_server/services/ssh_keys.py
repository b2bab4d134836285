"""People's SSH public keys, for shells on the robots that they manage, and what their ssh needs to reach these."""

from collections.abc import Sequence
from dataclasses import dataclass

from robotether_server import identity, schemas
from robotether_server.db import Transaction, audit, cells, seen_robots, users
from robotether_server.db.audit import Source
from robotether_server.db.grants import includes
from robotether_server.db.robots import RobotRow
from robotether_server.db.users import SshKey, User
from robotether_server.problems import FieldInvalidError, NotPossibleError
from robotether_server.schemas import MAX_NAME_LENGTH, Label
from robotether_server.settings.robot import ShellUser

MAX_KEYS = 20
JUMP_USER = "jump"


@dataclass(frozen=True)
class ShellEntry:
    """A robot's shell; `shell_user` None: the account that ssh would take anyway.

    `server`: host and port of the sshd where the robot is online; None: any, or unknown.
    """

    robot: str
    shell_port: int
    shell_user: str | None
    server: tuple[str, int] | None = None


def add(tx: Transaction, source: Source, user: User, name: str | None, line: str) -> SshKey:
    """Add a key, named as in its comment by default; FieldInvalidError, RecordExistsError or NotPossibleError."""
    key = identity.parse_persons_key(line)
    chosen = name or identity.key_comment(line)[:MAX_NAME_LENGTH].strip() or key.fingerprint
    schemas.check("name", chosen, Label)
    if len(users.list_ssh_keys(tx, user)) >= MAX_KEYS:
        raise NotPossibleError(
            f"cannot add SSH key {chosen}: user {user.name} has {MAX_KEYS}; delete one that is not used"
        )
    added = users.add_ssh_key(tx, user, chosen, key, source.api_token)
    audit.record(tx, source, "ssh_key_added", **_details(user, added))
    return added


def delete(tx: Transaction, source: Source, user: User, key_id: int) -> SshKey:
    """Delete a key of this user and return it; what it opened ends. Raises RecordMissingError."""
    key = users.get_ssh_key(tx, user, key_id)
    users.delete_ssh_key(tx, key.id)
    audit.record(tx, source, "ssh_key_deleted", **_details(user, key))
    return key


def _details(user: User, key: SshKey) -> dict[str, object]:
    return {"user": user.name, "key": key.name, "fingerprint": key.fingerprint}


def shell_entries(tx: Transaction, user: User) -> list[ShellEntry]:
    """Return the shells that this user may reach, by the robots' names."""
    by_name = {cell.name: cell for cell in cells.read(tx)}
    where = cells.names_by_robot(tx) if len(by_name) > 1 else {}
    return [
        ShellEntry(
            seen.robot.name,
            seen.robot.shell_port,
            _shell_user(seen.robot),
            _server_of(by_name.get(where.get(seen.robot.id) or "")),
        )
        for seen in seen_robots.list_seen(tx, user)
        if seen.robot.shell_port is not None
        and seen.robot.state == "active"
        and includes(seen.level, "manage")
    ]


def render_config(entries: Sequence[ShellEntry], host: str, port: int) -> str:
    """Return the text for ~/.ssh/config; `host` and `port` are where this site's sshd is reached."""
    return "\n".join(_entry(entry, *(entry.server or (host, port))) for entry in entries)


def _entry(entry: ShellEntry, host: str, port: int) -> str:
    address = f"[{host}]" if ":" in host else host
    lines = [
        f"Host {entry.robot}",
        "    HostName 127.0.0.1",
        f"    Port {entry.shell_port}",
        f"    HostKeyAlias robotether-{entry.robot}",
        f"    ProxyJump {JUMP_USER}@{address}:{port}",
        # Robots of two servers have the same host, port and %C: ssh would take one's connection for the other's.
        "    ControlPath none",
    ]
    if entry.shell_user is not None:
        lines.append(f"    User {entry.shell_user}")
    return "\n".join(lines) + "\n"


def _server_of(cell: cells.Cell | None) -> tuple[str, int] | None:
    return None if cell is None or cell.host is None else (cell.host, cell.ssh_ports[0])


def _shell_user(robot: RobotRow) -> str | None:
    """Return the setting; a text that somebody wrote by SQL must not become a line of its own."""
    user = robot.settings.get("shell_user")
    try:
        schemas.check("shell_user", user, ShellUser)
    except FieldInvalidError:
        return None
    return str(user)
