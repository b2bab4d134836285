"""robotether audit: who did what; and robotether audit prune, which shortens that log.

The accounts of the site itself may only add to the log. So prune is run as account migrate, by whoever administers the
machine, and not from the web container.
"""

import datetime as dt
import json
import os

import click

from robotether_server import settings
from robotether_server.cli.common import (
    JSON,
    SOURCE,
    NotDone,
    moment,
    open_database,
    print_json,
    print_table,
)
from robotether_server.store import audit
from robotether_server.store.audit import AuditEvent, Event

PRUNING_ACCOUNT = "migrate"
MOST_EVENTS = 10000


@click.group("audit", invoke_without_command=True)
@click.option("--robot", help="Only what concerns this robot.")
@click.option("--actor", help="Only what this user did, or `cli`.")
@click.option("--kind", help="Only events of this kind, such as robot_approved.")
@click.option(
    "--limit", type=click.IntRange(1, MOST_EVENTS), default=50, show_default=True, help="How many."
)
@JSON
@click.pass_context
def audit_log(
    context: click.Context,
    *,
    robot: str | None,
    actor: str | None,
    kind: str | None,
    limit: int,
    as_json: bool,
) -> None:
    """Show the audit log, the newest events last."""
    if context.invoked_subcommand is not None:
        return
    with open_database().transaction() as tx:
        found = audit.find(tx, robot=robot, actor=actor, kind=kind, limit=limit)[::-1]
    if as_json:
        print_json([vars(one) for one in found])
        return
    print_table(("AT", "WHO", "FROM", "WHAT", "ROBOT", "DETAILS"), [_as_row(one) for one in found])


@audit_log.command()
@click.option("--days", type=click.IntRange(1), required=True, help="Keep the events of so many.")
def prune(days: int) -> None:
    """Remove old events for good.

    To be run as: tools/compose run --rm migrate robotether audit prune --days 365
    """
    account = settings.load_database(os.environ).user
    if account != PRUNING_ACCOUNT:
        raise NotDone(
            f"cannot prune the audit log as account {account}, which may only add to it; use: "
            f"tools/compose run --rm migrate robotether audit prune --days {days}"
        )
    before = dt.datetime.now(dt.UTC) - dt.timedelta(days=days)
    database = open_database()
    removed = 0
    while True:
        # Piece by piece, so that nobody who writes to the log waits for long.
        with database.transaction() as tx:
            piece = audit.remove_some(tx, before)
        removed += piece
        if not piece:
            break
    with database.transaction() as tx:
        details: dict[str, object] = {"before": before.isoformat(), "events": removed}
        audit.record(tx, SOURCE, Event("audit_pruned", details=details))
    click.echo(f"removed {removed} events from before {moment(before, '')} UTC")


def _as_row(one: AuditEvent) -> tuple[str, ...]:
    details = " ".join(f"{name}={json.dumps(value)}" for name, value in one.details.items())
    return (
        moment(one.at, ""),
        one.actor,
        one.address or "-",
        one.kind,
        one.robot or "-",
        details,
    )
