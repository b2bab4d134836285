"""robotether user ...: who may log in, and who administers."""

import sys

import click

from robotether_server import passwords
from robotether_server.cli.common import (
    SOURCE,
    YES,
    add_list,
    open_database,
    remove_after_question,
)
from robotether_server.db import Database
from robotether_server.db import users as db_users
from robotether_server.db.users import ROLES, Role
from robotether_server.install_line import SiteAddress
from robotether_server.problems import StoreUnavailableError
from robotether_server.services import requests, users
from robotether_server.settings.server import DatabaseSettings, WebSettings

PASSWORD_STDIN = click.option(
    "--password-stdin",
    is_flag=True,
    help="Read the password from the first line of standard input.",
)

FIRST_ADMIN = """\
web: created the first admin. This is shown only once:
  open      https://{site}/
  user      {name}
  password  {password}"""


def ensure_first_admin(loaded: WebSettings) -> None:
    """Make the user admin on a server that has no user, and print the password if it was made here."""
    password = loaded.admin_password or passwords.new_password()
    password_text = "in compose/secrets/admin_password" if loaded.admin_password else password
    site = SiteAddress(
        loaded.site_address.public_host or "localhost", loaded.site_address.public_port
    )
    text = FIRST_ADMIN.format(site=site.authority, name=users.FIRST_ADMIN, password=password_text)
    try:
        with Database(loaded.database).transaction() as tx:
            if users.add_first(tx, SOURCE, password):
                # Before the end of the transaction: an admin whose password nobody knows would stay behind.
                click.echo(text)
    except StoreUnavailableError as problem:
        # At a reboot web may be there before the database, which then has its admin.
        click.echo(f"web: cannot check for a first admin: {problem.detail}", err=True)


def add_first_admin(database: DatabaseSettings, password: str) -> None:
    """Make the user admin with this password, where there is no user; raise StoreUnavailableError."""
    with Database(database).transaction() as tx:
        if users.add_first(tx, SOURCE, password):
            click.echo(f"made the first user: {users.FIRST_ADMIN}")


@click.group()
def user() -> None:
    """Add, list, change and remove users."""


@user.command()
@click.argument("name")
@click.option("--role", type=click.Choice(ROLES), default="user", show_default=True)
@PASSWORD_STDIN
def add(name: str, role: Role, password_stdin: bool) -> None:
    """Add a user. Without --password-stdin, makes a password and prints it as the last word."""
    chosen = _password(from_stdin=password_stdin)
    with open_database().transaction() as tx:
        users.add(tx, SOURCE, name, chosen, role)
    click.echo(f"added {role} {name}" + ("" if password_stdin else f" with password {chosen}"))


@user.command()
@click.argument("name")
@PASSWORD_STDIN
def password(name: str, password_stdin: bool) -> None:
    """Set a new password, and end the user's logins."""
    new = _password(from_stdin=password_stdin)
    with open_database().transaction() as tx:
        users.set_password(tx, SOURCE, name, new)
    click.echo(f"user {name} has a new password" + ("" if password_stdin else f": {new}"))


add_list(
    user,
    "List the users.",
    db_users.list_all,
    ("NAME", "ROLE", "STATE"),
    lambda user: (user.name, user.role, "disabled" if user.disabled else "enabled"),
    as_dict=lambda user: {"name": user.name, "role": user.role, "disabled": user.disabled},
)


@user.command()
@click.argument("name")
@click.argument("new_role", metavar="ROLE", type=click.Choice(ROLES))
def role(name: str, new_role: Role) -> None:
    """Make a user an admin, or an admin a user."""
    with open_database().transaction() as tx:
        users.set_role(tx, SOURCE, name, new_role)
    click.echo(f"user {name} has role {new_role}")


@user.command()
@click.argument("name")
def disable(name: str) -> None:
    """Disable a user: logins, tokens and SSH keys no longer work. To undo it: enable."""
    with open_database().transaction() as tx:
        users.set_disabled(tx, SOURCE, name, disabled=True)
    click.echo(f"disabled user {name}")


@user.command()
@click.argument("name")
def enable(name: str) -> None:
    """Enable a disabled user."""
    with open_database().transaction() as tx:
        users.set_disabled(tx, SOURCE, name, disabled=False)
    click.echo(f"enabled user {name}")


@user.command()
@click.argument("name")
@click.argument("pools_", metavar="[POOL]...", nargs=-1)
def pools(name: str, pools_: tuple[str, ...]) -> None:
    """Set the pools whose requests for help a user is offered, in place of the present ones; without POOL: none."""
    with open_database().transaction() as tx:
        new = requests.set_pools(tx, SOURCE, name, list(pools_))
    click.echo(f"user {name} is in {'pools ' + ', '.join(new) if new else 'no pool'}")


@user.command()
@click.argument("name")
def logout(name: str) -> None:
    """End all logins of a user, on every device; API tokens stay."""
    with open_database().transaction() as tx:
        ended = users.log_out_everywhere(tx, SOURCE, name)
    click.echo(f"ended {ended} {'login' if ended == 1 else 'logins'} of user {name}")


@user.command()
@click.argument("name")
@YES
def remove(name: str, yes: bool) -> None:
    """Remove a user with logins, tokens, SSH keys and grants. This cannot be undone."""
    remove_after_question(
        "user",
        name,
        f"Remove {{record.role}} {name}, with tokens, SSH keys and grants?",
        get=db_users.get,
        remove=users.remove,
        yes=yes,
    )


def _password(*, from_stdin: bool) -> str:
    return sys.stdin.readline().rstrip("\r\n") if from_stdin else passwords.new_password()
