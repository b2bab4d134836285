"""robotether token ...: what programs log in with; join-token ... and robot invite: what admits robots by itself."""

import datetime as dt
import os
from dataclasses import replace
from typing import get_args

import click

from robotether_server.cli.common import (
    SOURCE,
    NotDoneError,
    add_list,
    open_database,
    timestamp,
)
from robotether_server.db import credentials, join_tokens, users
from robotether_server.db.credentials import TokenUse
from robotether_server.db.join_tokens import Place
from robotether_server.install_line import (
    HTTPS_PORT,
    SiteAddress,
    SiteCertificates,
    enrolment_lines,
    parse_site_address,
)
from robotether_server.services import tokens
from robotether_server.settings.server import SiteAddressSettings, load

USER = click.option("--user", "user_name", required=True, help="Whose rights the token has.")
NAME = click.option("--name", required=True, help="What it is for; unique for this user.")


@click.group()
def token() -> None:
    """Create, list and delete API tokens."""


@token.command()
@USER
@NAME
@click.option(
    "--days",
    type=click.IntRange(1, tokens.MAX_DAYS),
    default=tokens.DEFAULT_DAYS,
    show_default=True,
    help="Number of days after which it ends.",
)
@click.option(
    "--only",
    type=click.Choice(get_args(TokenUse)),
    help="The only purpose of the token.  [default: all that the user may do]",
)
def create(user_name: str, name: str, days: int, only: TokenUse | None) -> None:
    """Create a token and print it once, as the last word."""
    with open_database().transaction() as tx:
        text = tokens.create(tx, SOURCE, users.get(tx, user_name), name, days, only_for=only)
    click.echo(f"token {name} of user {user_name}, shown only once: {text}")


add_list(
    token,
    "List the tokens, without their texts.",
    credentials.list_tokens,
    ("USER", "NAME", "CREATED", "ENDS", "ONLY FOR"),
    lambda api_token: (
        api_token.user,
        api_token.name,
        timestamp(api_token.created_at, ""),
        timestamp(api_token.expires_at, "never"),
        api_token.only_for or "",
    ),
)


@token.command()
@USER
@NAME
def delete(user_name: str, name: str) -> None:
    """Delete a token, with the join tokens and SSH keys that it made; what it opened ends."""
    with open_database().transaction() as tx:
        held = credentials.list_tokens_of(tx, users.get(tx, user_name))
        api_token = next((api_token for api_token in held if api_token.name == name), None)
        if api_token is None:
            raise NotDoneError(f"cannot delete token {name}: user {user_name} has no such token")
        tokens.delete(tx, SOURCE, api_token.id)
    click.echo(f"deleted token {name} of user {user_name}")


@click.command()
@click.option(
    "--uses",
    type=click.IntRange(1, tokens.MAX_USES),
    default=1,
    show_default=True,
    help="How many robots it admits.",
)
@click.option(
    "--hours",
    type=click.IntRange(1, tokens.MAX_HOURS),
    default=24,
    show_default=True,
    help="How long it is valid.",
)
@click.option("--name", help="Name of the robot.  [default: robot- and the end of its MAC]")
@click.option("--label", help="Name of the token.  [default: that of the robot and six digits]")
@click.option(
    "--host", metavar="HOST[:PORT]", help="Where robots reach this site.  [default: PUBLIC_HOST]"
)
@click.option("--site", help="Site of the robots.")
@click.option("--group", help="Group of users who may drive them.")
@click.option("--region", help="Region of the robots: its machines are first for them.")
def invite(
    uses: int,
    hours: int,
    name: str | None,
    label: str | None,
    host: str | None,
    **place: str | None,
) -> None:
    """Print the line that makes a machine a robot.

    The install line is the last line of the output. It holds a new join token: whoever has it can enrol that many
    robots until it expires, or until: robotether join-token delete.
    """
    certificates, site = _site(host)
    with open_database().transaction() as tx:
        ends = tx.now() + dt.timedelta(hours=hours)
        label, token = tokens.invite(
            tx, SOURCE, name, uses, ends, place=Place(**place), label=label
        )
        # Before the end of the transaction: a token that nobody has seen would stay behind otherwise.
        lines = enrolment_lines(certificates, site, token, name)
    robots = "1 robot" if uses == 1 else f"{uses} robots"
    click.echo(
        f"join token {label}, for {name or robots} until {timestamp(ends, '')}; run on the robot:"
    )
    if lines.warning:
        click.echo(f"warning: {lines.warning}", err=True)
    click.echo(lines.install)


@click.group("join-token")
def join_token() -> None:
    """List and delete join tokens.

    `robotether robot invite` makes them.
    """


add_list(
    join_token,
    "List the join tokens, without their texts, the newest first.",
    join_tokens.list_all,
    ("NAME", "USED", "CREATED", "BY", "ENDS"),
    lambda record: (
        record.name,
        f"{record.used} of {record.uses}",
        timestamp(record.created_at, ""),
        record.created_by,
        timestamp(record.expires_at, ""),
    ),
)


@join_token.command("delete")
@click.argument("name")
def delete_join_token(name: str) -> None:
    """Delete a join token; robots that it admitted stay."""
    with open_database().transaction() as tx:
        token_id = next(
            (record.id for record in join_tokens.list_all(tx) if record.name == name), None
        )
        if token_id is None:
            raise NotDoneError(f"cannot delete join token {name}: there is none of that name")
        tokens.delete_join_token(tx, SOURCE, token_id)
    click.echo(f"deleted join token {name}")


def _site(host: str | None) -> tuple[SiteCertificates, str]:
    """Return the certificates, and the address for robots; --host wins over PUBLIC_HOST."""
    loaded = load(SiteAddressSettings, os.environ)
    if host is None:
        if loaded.public_host is None:
            raise NotDoneError(
                "cannot write the line: PUBLIC_HOST is not set; set it in compose/.env, or say --host"
            )
        return SiteCertificates(loaded), loaded.public_host
    site = parse_site_address(host)
    if site.port == HTTPS_PORT and not host.endswith(f":{HTTPS_PORT}"):
        site = SiteAddress(site.host, loaded.public_port)
    return SiteCertificates(replace(loaded, public_host=None)), site.authority
