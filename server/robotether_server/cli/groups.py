"""robotether group ...: groups of users, whose grants every member has."""

import click

from robotether_server.cli.common import (
    JSON,
    SOURCE,
    YES,
    open_database,
    print_records,
    remove_after_question,
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
        groups = grants.list_groups(tx)
    print_records(
        groups,
        ("NAME", "MEMBERS"),
        lambda record: (record.name, " ".join(record.members) or "-"),
        as_json=as_json,
        as_dict=lambda record: {"name": record.name, "members": record.members},
    )


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
@YES
def remove(name: str, yes: bool) -> None:
    """Remove a group with its grants. Its members stay users."""
    remove_after_question(
        "group",
        name,
        f"Remove group {name}, with its grants?",
        get=grants.get_group,
        remove=grant_service.remove_group,
        yes=yes,
    )
