"""robotether rejected ...: keys that were turned away."""

import click

from robotether_server.cli.common import (
    JSON,
    SOURCE,
    open_database,
    print_json,
    print_table,
    timestamp,
)
from robotether_server.services import pending

HEADS = ("ID", "ROBOT", "MAC", "HOST NAME", "ADDRESS", "REJECTED", "BY", "KEY")


@click.group()
def rejected() -> None:
    """List keys that were turned away, and let them ask again."""


@rejected.command("list")
@JSON
def list_rejected(as_json: bool) -> None:
    """List the keys that were turned away, the newest first."""
    with open_database().transaction() as tx:
        found = pending.rejected(tx)
    if as_json:
        print_json([vars(one) for one in found])
        return
    rows = [
        (
            str(one.id),
            one.robot,
            one.mac,
            one.hostname,
            one.address,
            timestamp(one.rejected_at, ""),
            one.rejected_by,
            one.fingerprint,
        )
        for one in found
    ]
    print_table(HEADS, rows)


@rejected.command()
@click.argument("rejected_id", metavar="ID", type=int)
def forgive(rejected_id: int) -> None:
    """Let a rejected key ask again; it waits for approval then."""
    with open_database().transaction() as tx:
        forgiven = pending.forgive(tx, SOURCE, rejected_id)
    click.echo(f"key {forgiven.fingerprint} may ask again")
