"""robotether user ...: who may log in; and robotether grant, revoke: to which robots."""

import sys

import click

from robotether_server import passwords
from robotether_server.cli.common import SOURCE, NotDone, open_database, print_table
from robotether_server.store import audit, grants, robots, users
from robotether_server.store.audit import Event
from robotether_server.store.grants import LEVELS, Level
from robotether_server.store.users import ROLES, Role

PASSWORD_STDIN = click.option(
    "--password-stdin",
    is_flag=True,
    help="Read the password from the first line of standard input.",
)


@click.group()
def user() -> None:
    """Add, list, disable and enable users, and set passwords."""


@user.command()
@click.argument("name")
@click.option("--role", type=click.Choice(ROLES), default="user", show_default=True)
@PASSWORD_STDIN
def add(name: str, role: Role, password_stdin: bool) -> None:
    """Add a user. Without --password-stdin, makes a password and prints it as the last word."""
    given = _password_of_stdin() if password_stdin else None
    password = passwords.new_password() if given is None else given
    hashed = passwords.hash_password(password)
    with open_database().transaction() as tx:
        users.add(tx, name, hashed, role)
        audit.record(tx, SOURCE, Event("user_added", details={"user": name, "role": role}))
    click.echo(f"added {role} {name}" + ("" if password_stdin else f" with password {password}"))


@user.command()
@click.argument("name")
@PASSWORD_STDIN
def password(name: str, password_stdin: bool) -> None:
    """Set a new password, and end the user's logins."""
    given = _password_of_stdin() if password_stdin else None
    new = passwords.new_password() if given is None else given
    hashed = passwords.hash_password(new)
    with open_database().transaction() as tx:
        users.set_password(tx, users.get(tx, name).id, hashed)
        audit.record(tx, SOURCE, Event("password_set", details={"user": name}))
    click.echo(f"user {name} has a new password" + ("" if password_stdin else f": {new}"))


@user.command("list")
def list_users() -> None:
    """List the users."""
    with open_database().transaction() as tx:
        found = users.list_all(tx)
    rows = [(one.name, one.role, "disabled" if one.disabled else "enabled") for one in found]
    print_table(("NAME", "ROLE", "STATE"), rows)


@user.command()
@click.argument("name")
def disable(name: str) -> None:
    """Keep a user out; logins and tokens work no more."""
    _set_disabled(name, disabled=True)


@user.command()
@click.argument("name")
def enable(name: str) -> None:
    """Let a disabled user in again."""
    _set_disabled(name, disabled=False)


def _set_disabled(name: str, *, disabled: bool) -> None:
    done = "disabled" if disabled else "enabled"
    with open_database().transaction() as tx:
        users.set_disabled(tx, users.get(tx, name).id, disabled=disabled)
        audit.record(tx, SOURCE, Event(f"user_{done}", details={"user": name}))
    click.echo(f"{done} user {name}")


@click.command()
@click.argument("user_name", metavar="USER")
@click.argument("robot_name", metavar="ROBOT")
@click.argument("level", type=click.Choice(LEVELS))
def grant(user_name: str, robot_name: str, level: Level) -> None:
    """Let USER observe, drive or manage ROBOT, in place of an earlier grant."""
    with open_database().transaction() as tx:
        robot = robots.get(tx, robot_name)
        grants.give(tx, users.get(tx, user_name).id, robot.id, level)
        details: dict[str, object] = {"user": user_name, "level": level}
        audit.record(tx, SOURCE, Event("grant_given", robot_name, details))
    click.echo(f"user {user_name} may {level} robot {robot_name}")


@click.command()
@click.argument("user_name", metavar="USER")
@click.argument("robot_name", metavar="ROBOT")
def revoke(user_name: str, robot_name: str) -> None:
    """Take USER's grant for ROBOT away."""
    with open_database().transaction() as tx:
        robot = robots.get(tx, robot_name)
        if not grants.take(tx, users.get(tx, user_name).id, robot.id):
            raise NotDone(f"cannot revoke: user {user_name} has no grant for robot {robot_name}")
        audit.record(tx, SOURCE, Event("grant_taken", robot_name, {"user": user_name}))
    click.echo(f"user {user_name} has no grant for robot {robot_name} any more")


def _password_of_stdin() -> str:
    return sys.stdin.readline().rstrip("\r\n")
