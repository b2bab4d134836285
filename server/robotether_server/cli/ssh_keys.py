"""robotether ssh-key ... and ssh-config: people's keys for shells on robots, and how they get there."""

import os
from typing import TextIO

import click

from robotether_server.cli.common import (
    JSON,
    SOURCE,
    NotDoneError,
    open_database,
    print_records,
    timestamp,
)
from robotether_server.db import users
from robotether_server.services import ssh_keys
from robotether_server.settings.server import JoinSettings, load

USER = click.option("--user", "user_name", required=True, help="Whose key it is.")


@click.group("ssh-key")
def ssh_key() -> None:
    """Add, list and delete people's SSH keys.

    They open shells on robots that the person manages.
    """


@ssh_key.command()
@USER
@click.option("--name", help="What to call it.  [default: the key's comment]")
@click.argument("file", type=click.File(), default="-")
def add(user_name: str, name: str | None, file: TextIO) -> None:
    """Add the public key in FILE, such as id_ed25519.pub, or on standard input."""
    with open_database().transaction() as tx:
        added = ssh_keys.add(tx, SOURCE, users.get(tx, user_name), name, file.read().strip())
    click.echo(f"added SSH key {added.name} of user {user_name}: {added.fingerprint}")


@ssh_key.command("list")
@USER
@JSON
def list_keys(user_name: str, as_json: bool) -> None:
    """List a user's SSH keys."""
    with open_database().transaction() as tx:
        keys = users.list_ssh_keys(tx, users.get(tx, user_name))
    print_records(
        keys,
        ("NAME", "ADDED", "KEY"),
        lambda key: (key.name, timestamp(key.created_at, ""), key.fingerprint),
        as_json=as_json,
    )


@ssh_key.command()
@USER
@click.argument("name")
def delete(user_name: str, name: str) -> None:
    """Delete a user's SSH key; what it opened ends."""
    with open_database().transaction() as tx:
        user = users.get(tx, user_name)
        key = next((key for key in users.list_ssh_keys(tx, user) if key.name == name), None)
        if key is None:
            raise NotDoneError(
                f"cannot delete SSH key {name}: user {user_name} has none of that name"
            )
        ssh_keys.delete(tx, SOURCE, user, key.id)
    click.echo(f"deleted SSH key {name} of user {user_name}")


@click.command("ssh-config")
@click.option("--user", "user_name", required=True, help="Whose entries.")
@click.option("--host", help="Where people reach this server.  [default: PUBLIC_HOST]")
def print_ssh_config(user_name: str, host: str | None) -> None:
    """Print a person's entries for ~/.ssh/config.

    One Host entry a robot whose shell the person may reach. With it, ssh NAME, scp, rsync, Ansible and
    `robotether fleet` reach robots behind NAT.
    """
    join = load(JoinSettings, os.environ)
    where = host or join.public_host
    if where is None:
        raise NotDoneError(
            "cannot print entries: PUBLIC_HOST is not set; set it in compose/.env, or say --host"
        )
    with open_database().transaction() as tx:
        entries = ssh_keys.shell_entries(tx, users.get(tx, user_name))
    if not entries:
        raise NotDoneError(
            f"cannot print entries: user {user_name} manages no active robot whose shell is on; "
            f"see: robotether robot shell, robotether grant"
        )
    click.echo(ssh_keys.render_config(entries, where, join.ssh_ports[0]), nl=False)
