"""robotether site ...: sites of robots; a grant can be for all robots of a site."""

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
def site() -> None:
    """Add, list, fill and remove sites of robots."""


@site.command()
@click.argument("name")
def add(name: str) -> None:
    """Add a site without robots. Give grants for it with: grant USER --site NAME LEVEL."""
    with open_database().transaction() as tx:
        grant_service.add_site(tx, SOURCE, name)
    click.echo(f"added site {name}")


@site.command("list")
@JSON
def list_sites(as_json: bool) -> None:
    """List the sites with their robots."""
    with open_database().transaction() as tx:
        sites = grants.list_sites(tx)
    print_records(
        sites,
        ("NAME", "ROBOTS"),
        lambda record: (record.name, " ".join(record.robots) or "-"),
        as_json=as_json,
        as_dict=lambda record: {"name": record.name, "robots": record.robots},
    )


@site.command()
@click.argument("robot")
@click.argument("name", required=False)
def place(robot: str, name: str | None) -> None:
    """Put ROBOT at site NAME; without NAME at none. It leaves the site where it was."""
    with open_database().transaction() as tx:
        grant_service.place_robot(tx, SOURCE, robot, name)
    click.echo(f"robot {robot} is at {'no site' if name is None else f'site {name}'}")


@site.command()
@click.argument("name")
@YES
def remove(name: str, yes: bool) -> None:
    """Remove a site with its grants. Its robots stay, at no site."""
    remove_after_question(
        "site",
        name,
        f"Remove site {name}, with its grants?",
        get=grants.get_site,
        remove=grant_service.remove_site,
        yes=yes,
    )
