"""What the commands share: the database, how they sign the audit log, questions, tables and JSON."""

import datetime as dt
import json
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from time import monotonic, sleep
from typing import Any, TypeVar

import click

from robotether_server.db import Database, Transaction
from robotether_server.db.audit import Source
from robotether_server.problems import RobotetherError, SettingsError
from robotether_server.settings.server import DatabaseSettings, load

T = TypeVar("T")

SOURCE = Source("cli")
POLL_S = 0.5

JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
YES = click.option("--yes", is_flag=True, help="Remove it without asking.")


class NotDoneError(RobotetherError, code="not_done"):
    """A command that understood its arguments cannot do what they ask."""


def open_database() -> Database:
    """Return the database that the environment names, as it does in the container of web."""
    try:
        return Database(load(DatabaseSettings, os.environ))
    except SettingsError as problem:
        raise NotDoneError(
            f"{problem.detail}. On the server, run: docker compose exec web robotether"
        ) from problem


def agree(action: str, question: str, without_terminal: str) -> None:
    """Ask the person at the terminal; raise NotDoneError for a no, or when there is nobody to ask."""
    if not sys.stdin.isatty():
        raise NotDoneError(f"cannot {action}: there is no terminal to ask on; {without_terminal}")
    if not click.confirm(question):
        raise NotDoneError(f"did not {action}: the answer was no")


def remove_after_question(
    kind: str,
    name: str,
    question: str,
    *,
    get: Callable[[Transaction, str], object],
    remove: Callable[..., object],
    yes: bool,
    describe: Callable[[Any], Sequence[tuple[str, str]]] = lambda _: (),
) -> None:
    """Ask whether to remove what `get` finds, unless `yes`, and remove it; the question may have fields of `record`.

    What got the name after the question stays.
    """
    database = open_database()
    with database.transaction() as tx:
        record = get(tx, name)
    if not yes:
        print_fields(describe(record))
        text = question.format(record=record)
        agree(f"remove {kind} {name}", text, f"say --yes to remove the {kind}")
    with database.transaction() as tx:
        if getattr(get(tx, name), "id", None) != getattr(record, "id", None):
            raise NotDoneError(f"did not remove {kind} {name}: another one has the name now")
        remove(tx, SOURCE, name=name)
    click.echo(f"removed {kind} {name}")


def harmless(text: str) -> str:
    """Return a text with what is not printable spelt out.

    Anybody chooses the name that a failed login leaves in the audit log, and robots what they say of themselves:
    neither may control the terminal of the admin who reads it, nor feign a line of its own.
    """
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )


def print_fields(fields: Sequence[tuple[str, str]]) -> None:
    """Print one record, a field a line."""
    width = max((len(name) for name, _ in fields), default=0)
    for name, value in fields:
        click.echo(f"{name.ljust(width)}  {harmless(value)}")


def print_table(heads: Sequence[str], rows: Sequence[Sequence[str]], *, err: bool = False) -> None:
    """Print rows under their heads in columns, perhaps on standard error."""
    rows = [[harmless(cell) for cell in row] for row in rows]
    widths = [max(len(cell) for cell in column) for column in zip(heads, *rows, strict=True)]
    for row in (heads, *rows):
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        click.echo("  ".join(cells).rstrip(), err=err)


def print_records(
    records: Iterable[T],
    heads: Sequence[str],
    as_row: Callable[[T], Sequence[str]],
    *,
    as_json: bool,
    as_dict: Callable[[T], Mapping[str, Any]] = vars,
) -> None:
    """Print a list: a table for people, or JSON for programs."""
    if as_json:
        print_json([as_dict(record) for record in records])
    else:
        print_table(heads, [as_row(record) for record in records])


def add_list(
    commands: click.Group,
    about: str,
    read: Callable[[Transaction], Iterable[T]],
    heads: Sequence[str],
    as_row: Callable[[T], Sequence[str]],
    *,
    as_dict: Callable[[T], Mapping[str, Any]] = vars,
    name: str = "list",
) -> None:
    """Add a command that prints all that `read` returns; `about` is its help."""

    @commands.command(name, help=about)
    @JSON
    def run(as_json: bool) -> None:
        with open_database().transaction() as tx:
            records = read(tx)
        print_records(records, heads, as_row, as_json=as_json, as_dict=as_dict)


def print_json(value: object) -> None:
    """Print for programs; times are ISO 8601."""
    click.echo(json.dumps(value, indent=2, default=_as_text))


def timestamp(at: dt.datetime | None, otherwise: str) -> str:
    """Return a time as people read it, with its zone."""
    return f"{at:%Y-%m-%d %H:%M:%S} UTC" if at else otherwise


def wait_for(condition: Callable[[], T | None], seconds: float) -> T | None:
    """Ask the database again and again until it gives something, for at most that long."""
    end = monotonic() + seconds
    while (value := condition()) is None and monotonic() < end:
        sleep(POLL_S)
    return value


def _as_text(value: object) -> str:
    if isinstance(value, dt.datetime):
        return value.isoformat()
    raise TypeError(f"{value!r} has no place in JSON")
