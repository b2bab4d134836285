"""robotether audit: who did what. The site's accounts only add to that log; the database prunes it (AUDIT_DAYS)."""

import json

import click

from robotether_server.cli.common import JSON, open_database, print_records, timestamp
from robotether_server.contract.audit import AuditEvent
from robotether_server.db import audit

MAX_EVENTS = 10000


@click.command("audit")
@click.option("--robot", help="Only events of this robot.")
@click.option("--actor", help="Only events of this user, or of `cli`.")
@click.option("--kind", help="Only events of this kind, such as robot_approved.")
@click.option(
    "--limit", type=click.IntRange(1, MAX_EVENTS), default=50, show_default=True, help="How many."
)
@JSON
def audit_log(
    *,
    robot: str | None,
    actor: str | None,
    kind: str | None,
    limit: int,
    as_json: bool,
) -> None:
    """Show the audit log, the newest events last."""
    with open_database().transaction() as tx:
        events = audit.find(tx, audit.AuditSearch(robot, actor, kind), limit=limit)[::-1]
    heads = ("AT", "WHO", "FROM", "WHAT", "ROBOT", "DETAILS")
    print_records(events, heads, _as_row, as_json=as_json)


def _as_row(event: AuditEvent) -> tuple[str, ...]:
    details = " ".join(f"{name}={json.dumps(value)}" for name, value in event.details.items())
    return (
        timestamp(event.at, ""),
        event.actor,
        event.address or "-",
        event.kind,
        event.robot or "-",
        details,
    )
