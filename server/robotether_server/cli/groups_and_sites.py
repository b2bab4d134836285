"""robotether group ...: groups of users, whose grants every member has; site ...: sites of robots.

A grant can be for a group in place of a user, and for all robots of a site.
"""

from functools import partial

import click

from robotether_server.cli.common import (
    SOURCE,
    YES,
    add_list,
    open_database,
    remove_after_question,
)
from robotether_server.db.grants import GROUPS, SITES, Collection, R
from robotether_server.services import grants


def _commands(collection: Collection[R], *, about: str, add: str, remove: str) -> click.Group:
    """Return the commands that groups and sites have in common, with these help texts."""
    kind, members = collection.kind, collection.members
    commands = click.Group(kind, help=about)
    add_list(
        commands,
        f"List the {kind}s with their {members}.",
        collection.list_all,
        ("NAME", members.upper()),
        lambda record: (record.name, " ".join(record.members) or "-"),
        as_dict=lambda record: {"name": record.name, members: record.members},
    )

    @commands.command("add", help=add)
    @click.argument("name")
    def add_one(name: str) -> None:
        with open_database().transaction() as tx:
            grants.add_collection(tx, SOURCE, collection, name)
        click.echo(f"added {kind} {name}")

    @commands.command("remove", help=remove)
    @click.argument("name")
    @YES
    def remove_one(name: str, yes: bool) -> None:
        remove_after_question(
            kind,
            name,
            f"Remove {kind} {name}, with its grants?",
            get=collection.get,
            remove=partial(grants.remove_collection, collection=collection),
            yes=yes,
        )

    return commands


group = _commands(
    GROUPS,
    about="Add, list, fill and remove groups of users.",
    add="Add a group without members. Give it grants with: grant --group NAME ROBOT LEVEL.",
    remove="Remove a group with its grants. Its members stay users.",
)
site = _commands(
    SITES,
    about="Add, list, fill and remove sites of robots.",
    add="Add a site without robots. Give grants for it with: grant USER --site NAME LEVEL.",
    remove="Remove a site with its grants. Its robots stay, at no site.",
)


@group.command()
@click.argument("name")
@click.argument("user")
def join(name: str, user: str) -> None:
    """Make USER a member of group NAME."""
    with open_database().transaction() as tx:
        grants.add_member(tx, SOURCE, name, user)
    click.echo(f"user {user} is a member of group {name}")


@group.command()
@click.argument("name")
@click.argument("user")
def leave(name: str, user: str) -> None:
    """End USER's membership in group NAME; what only its grants opened ends."""
    with open_database().transaction() as tx:
        grants.remove_member(tx, SOURCE, name, user)
    click.echo(f"user {user} is no longer a member of group {name}")


@site.command()
@click.argument("robot")
@click.argument("name", required=False)
def place(robot: str, name: str | None) -> None:
    """Put ROBOT at site NAME; without NAME at none. It leaves the site where it was."""
    with open_database().transaction() as tx:
        grants.place_robot(tx, SOURCE, robot, name)
    click.echo(f"robot {robot} is at {'no site' if name is None else f'site {name}'}")
