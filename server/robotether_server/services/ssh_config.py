"""The entries that a person's ssh needs to reach the shells of robots: one Host a robot."""

from collections.abc import Sequence
from dataclasses import dataclass

from robotether_server import schemas
from robotether_server.db import Transaction, seen_robots
from robotether_server.db.grants import includes
from robotether_server.db.robots import Robot
from robotether_server.db.users import User
from robotether_server.problems import FieldInvalid
from robotether_server.robot_settings import ShellUser

JUMP_USER = "jump"


@dataclass(frozen=True)
class ShellEntry:
    """A robot's shell; `shell_user` None: the account that ssh would take anyway."""

    robot: str
    shell_port: int
    shell_user: str | None


def entries(tx: Transaction, user: User) -> list[ShellEntry]:
    """Return the shells that this user may reach, by the robots' names."""
    return [
        ShellEntry(seen.robot.name, seen.robot.shell_port, _shell_user(seen.robot))
        for seen in seen_robots.list_seen(tx, user)
        if seen.robot.shell_port is not None
        and seen.robot.state == "active"
        and includes(seen.level, "manage")
    ]


def render(entries: Sequence[ShellEntry], host: str, port: int) -> str:
    """Return the text for ~/.ssh/config; `host` and `port` are where this site's sshd is reached."""
    shown = f"[{host}]" if ":" in host else host
    return "\n".join(_entry(entry, f"{JUMP_USER}@{shown}:{port}") for entry in entries)


def _entry(entry: ShellEntry, jump: str) -> str:
    lines = [
        f"Host {entry.robot}",
        "    HostName 127.0.0.1",
        f"    Port {entry.shell_port}",
        f"    HostKeyAlias robotether-{entry.robot}",
        f"    ProxyJump {jump}",
    ]
    if entry.shell_user is not None:
        lines.append(f"    User {entry.shell_user}")
    return "\n".join(lines) + "\n"


def _shell_user(robot: Robot) -> str | None:
    """Return the setting; a text that somebody wrote by SQL must not become a line of its own."""
    found = robot.settings.get("shell_user")
    try:
        schemas.check("shell_user", found, ShellUser)
    except FieldInvalid:
        return None
    return str(found)
