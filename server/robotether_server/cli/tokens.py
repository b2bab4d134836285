"""robotether token ...: what programs log in with."""

import datetime as dt

import click

from robotether_server.cli.common import (
    JSON,
    SOURCE,
    NotDone,
    open_database,
    print_json,
    print_table,
)
from robotether_server.db import credentials, users
from robotether_server.services import tokens

MAX_DAYS = 3650

USER = click.option("--user", "user_name", required=True, help="Whose rights the token has.")
NAME = click.option("--name", required=True, help="What it is for; unique for this user.")


@click.group()
def token() -> None:
    """Create, list and delete API tokens."""


@token.command()
@USER
@NAME
@click.option("--days", type=click.IntRange(1, MAX_DAYS), help="Ends after so many days.")
def create(user_name: str, name: str, days: int | None) -> None:
    """Create a token and print it once, as the last word."""
    expires_at = dt.datetime.now(dt.UTC) + dt.timedelta(days=days) if days else None
    with open_database().transaction() as tx:
        text = tokens.create(tx, SOURCE, users.get(tx, user_name), name, expires_at)
    click.echo(f"token {name} of user {user_name}, shown only once: {text}")


@token.command("list")
@JSON
def list_tokens(as_json: bool) -> None:
    """List the tokens, without their texts."""
    with open_database().transaction() as tx:
        found = credentials.list_tokens(tx)
    if as_json:
        print_json([vars(one) for one in found])
        return
    rows = [
        (
            one.user,
            one.name,
            f"{one.created_at:%Y-%m-%d}",
            f"{one.expires_at:%Y-%m-%d %H:%M}" if one.expires_at else "never",
        )
        for one in found
    ]
    print_table(("USER", "NAME", "CREATED", "ENDS"), rows)


@token.command()
@USER
@NAME
def delete(user_name: str, name: str) -> None:
    """Delete a token; what it opened ends."""
    with open_database().transaction() as tx:
        held = credentials.list_tokens_of(tx, users.get(tx, user_name))
        found = next((one for one in held if one.name == name), None)
        if found is None:
            raise NotDone(f"cannot delete token {name}: user {user_name} has no such token")
        tokens.delete(tx, SOURCE, found.id)
    click.echo(f"deleted token {name} of user {user_name}")
