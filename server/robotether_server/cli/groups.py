"""robotether group ...: groups of users, whose grants every member has."""

import click

from robotether_server.cli.common import (
    JSON,
    SOURCE,
    agree,
    open_database,
    print_json,
    print_table,
)
from robotether_server.db import grants
from robotether_server.services import grants as grant_service


@click.group()
def group() -> None:
    """Add, list, fill and remove groups of users."""


@group.command()
@click.argument("name")
def add(name: str) -> None:
    """Add a group without members. Give it grants with: grant --group NAME ROBOT LEVEL."""
    with open_database().transaction() as tx:
        grant_service.add_group(tx, SOURCE, name)
    click.echo(f"added group {name}")


@group.command("list")
@JSON
def list_groups(as_json: bool) -> None:
    """List the groups with their members."""
    with open_database().transaction() as tx:
        found = grants.list_groups(tx)
    if as_json:
        print_json([{"name": one.name, "members": list(one.members)} for one in found])
        return
    print_table(("NAME", "MEMBERS"), [(one.name, " ".join(one.members) or "-") for one in found])


@group.command()
@click.argument("name")
@click.argument("user")
def join(name: str, user: str) -> None:
    """Make USER a member of group NAME."""
    with open_database().transaction() as tx:
        grant_service.add_member(tx, SOURCE, name, user)
    click.echo(f"user {user} is a member of group {name}")


@group.command()
@click.argument("name")
@click.argument("user")
def leave(name: str, user: str) -> None:
    """End USER's membership in group NAME; what only its grants opened ends."""
    with open_database().transaction() as tx:
        grant_service.remove_member(tx, SOURCE, name, user)
    click.echo(f"user {user} is no longer a member of group {name}")


@group.command()
@click.argument("name")
@click.option("--yes", is_flag=True, help="Remove the group without asking.")
def remove(name: str, yes: bool) -> None:
    """Remove a group with its grants. Its members stay users."""
    database = open_database()
    with database.transaction() as tx:
        grants.get_group(tx, name)
    if not yes:
        agree(
            f"remove group {name}",
            f"Remove group {name}, with its grants?",
            "say --yes to remove the group",
        )
    with database.transaction() as tx:
        grant_service.remove_group(tx, SOURCE, name)
    click.echo(f"removed group {name}")
