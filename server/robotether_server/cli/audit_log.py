"""robotether audit: who did what, and whether the log was changed since (docs/reference/audit-log.md).

The site's accounts only add to that log; the database prunes it (AUDIT_DAYS).
"""

import dataclasses
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import msgspec

from robotether_server import audit_chain, signatures
from robotether_server.audit_chain import ChainReport, Record, Restore, SignedHead
from robotether_server.cli.common import (
    JSON,
    NotDoneError,
    harmless,
    open_database,
    print_json,
    print_records,
    timestamp,
)
from robotether_server.contract.audit import AuditEvent
from robotether_server.db import audit, audit_chains
from robotether_server.settings.server import SessionKeySettings, load

MAX_EVENTS = 10000
# Maximum number of lines in no chain that `verify` names.
MAX_OUTSIDE = 10
# Exit status of `verify` where all that is there fits, and a backup was put back.
PUT_BACK = 3
FILE = click.Path(exists=True, dir_okay=False, path_type=Path)


@click.group("audit", invoke_without_command=True)
@click.option("--robot", help="Only events of this robot.")
@click.option("--actor", help="Only events of this user, or of `cli`.")
@click.option("--kind", help="Only events of this kind, such as robot_approved.")
@click.option(
    "--limit", type=click.IntRange(1, MAX_EVENTS), default=50, show_default=True, help="How many."
)
@JSON
@click.pass_context
def audit_log(
    ctx: click.Context,
    *,
    robot: str | None,
    actor: str | None,
    kind: str | None,
    limit: int,
    as_json: bool,
) -> None:
    """Show the audit log, the newest events last."""
    if ctx.invoked_subcommand is not None:
        return
    with open_database().transaction() as tx:
        events = audit.find(tx, audit.AuditSearch(robot, actor, kind), limit=limit + 1)
    heads = ("AT", "WHO", "FROM", "WHAT", "ROBOT", "DETAILS")
    print_records(events[:limit][::-1], heads, _as_row, as_json=as_json)
    if len(events) > limit:
        click.echo(f"older events than the newest {limit} are left out: see --limit", err=True)


@audit_log.command()
@click.argument("file", type=FILE, required=False)
@click.option(
    "--server-key",
    "server_keys",
    multiple=True,
    help="Fingerprint of a key that may sign for the server.",
)
@click.option("--against", type=FILE, help="An earlier export, whose signed heads must fit.")
@JSON
def verify(
    file: Path | None, server_keys: tuple[str, ...], against: Path | None, *, as_json: bool
) -> None:
    """Check that no line of the database, or of an exported FILE, was changed, swapped or removed.

    Exits with status 3 if all fits and a backup was restored: lines after the backup may be lost.
    """
    older = _older_heads(against)
    if file is None:
        with open_database().transaction() as tx:
            records = audit_chains.read_chains(tx)
            reports = audit_chain.check(records, server_keys=server_keys, older_heads=older)
            outside = audit_chains.lines_outside(tx, MAX_OUTSIDE + 1)
    else:
        reports = audit_chain.check(read_export(file), server_keys=server_keys, older_heads=older)
        outside = []
    if not reports and not outside:
        raise NotDoneError(f"cannot verify {file or 'the audit log'}: it has no line")
    if as_json:
        print_json([dataclasses.asdict(report) for report in reports])
    else:
        for report in reports:
            click.echo(harmless(_sentence(report)))
    faults = [f"{report.name}: {report.fault}" for report in reports if report.fault]
    faults += [f"line with id {number} is in no chain" for number in outside[:MAX_OUTSIDE]]
    if len(outside) > MAX_OUTSIDE:
        faults.append("so are further lines")
    if faults:
        raise NotDoneError(f"cannot verify the audit log: {harmless('; '.join(faults))}")
    if any(report.restores for report in reports):
        sys.exit(PUT_BACK)


@audit_log.command()
@click.option("--robot", help="Only the chain of this robot.")
def export(robot: str | None) -> None:
    """Print the chains and their signed heads, a JSON object a line, for `audit verify FILE`."""
    is_empty = True
    with open_database().transaction() as tx:
        for record in audit_chains.read_chains(tx, robot):
            is_empty = False
            click.echo(msgspec.json.encode(record).decode())
    if is_empty:
        of_robot = "" if robot is None else f" of robot {robot}"
        raise NotDoneError(f"cannot export the audit log{of_robot}: it has no line")


@audit_log.command()
def key() -> None:
    """Print the fingerprint of the server's key, which signs heads; run it where the relay runs."""
    secret = load(SessionKeySettings, os.environ).session_key
    signing_key = audit_chain.server_key(secret)
    click.echo(signatures.fingerprint(signing_key.public_key))


def read_export(file: Path) -> Iterator[Record]:
    """Read what `audit export` wrote; raise NotDoneError for another file."""
    decoder: msgspec.json.Decoder[Record] = msgspec.json.Decoder(Record)
    with file.open("rb") as lines:
        for number, line in enumerate(lines, 1):
            try:
                yield decoder.decode(line)
            except (msgspec.MsgspecError, UnicodeDecodeError) as error:  # noqa: PERF203 - names the line
                raise NotDoneError(
                    f"cannot verify {file}: line {number} of the file is not as `audit export` writes it"
                ) from error


def _older_heads(file: Path | None) -> dict[str, list[SignedHead]]:
    heads: dict[str, list[SignedHead]] = {}
    for record in () if file is None else read_export(file):
        if isinstance(record, SignedHead):
            heads.setdefault(record.chain, []).append(record)
    if file is not None and not heads:
        raise NotDoneError(f"cannot verify the audit log against {file}: it has no signed head")
    return heads


def _sentence(report: ChainReport) -> str:
    if report.fault:
        return f"{report.name}: DOES NOT FIT: {report.fault}"
    parts = [f"{report.lines} lines fit"]
    if report.deleted:
        parts.append(f"lines 1 to {report.deleted} were deleted for their age")
    for signer in ("server", "robot"):
        if signer in report.signed:
            keys = ", ".join(report.keys[signer])
            parts.append(f"signed by the {signer} up to line {report.signed[signer]} ({keys})")
        elif signer == "server" or report.chain:
            parts.append(f"not signed by the {signer}")
    parts += [f"the robot started to sign again at line {line}" for line in report.restarts]
    parts += map(_restore_words, report.restores)
    return f"{report.name}: {'; '.join(parts)}"


def _restore_words(restore: Restore) -> str:
    words = f"A BACKUP WAS PUT BACK at {restore.at} (line {restore.line})"
    if restore.lost_up_to is None:
        words += ": whether lines are lost since then is not known"
    else:
        words += f": {_lost(restore.line, restore.lost_up_to)}"
    if restore.perhaps_up_to is None:
        return words
    return f"{words}; {_lost(restore.line, restore.perhaps_up_to)}, by this or another restore"


def _lost(first: int, last: int) -> str:
    lines = "1 line" if first == last else f"{last - first + 1} lines"
    return f"{lines} that the robot had signed are lost, up to line {last}"


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
