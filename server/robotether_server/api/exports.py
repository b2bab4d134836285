"""Writes records as a streamed file: CSV for spreadsheets, or a JSON object a line for programs.

Used by the API and the pages for the audit log and the drives. Must never give a spreadsheet a cell that it would run.
"""

import csv
import io
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice
from typing import Annotated, Literal, Protocol, TypeVar

from flask import Response, request, stream_with_context
from msgspec import UNSET, Meta, Struct, UnsetType

from robotether_server.api import auth
from robotether_server.api.context import context
from robotether_server.api.operations import plain
from robotether_server.schemas import GivenTimestamp, Label, Mac

Format = Literal["csv", "jsonl"]
FORMATS: tuple[Format, ...] = ("csv", "jsonl")
MAX_ID = 2**63 - 1
FILE_TYPES = ("text/csv", "application/jsonl")
USUAL_LIMIT = 100
Limit = Annotated[
    int,
    Meta(
        ge=1,
        le=500,
        description="The most entries in the answer",
        extra_json_schema={"default": USUAL_LIMIT},
    ),
]
RobotMac = Annotated[
    Mac, Meta(description="Of the robot that has this MAC now, whatever its name is or was")
]
FORMAT_WORDS = "All entries that match (up to limit, if given) as CSV, or as one JSON object a line"
TYPES: Mapping[Format, str] = {"csv": "text/csv; charset=utf-8", "jsonl": "application/jsonl"}
PIECE = 500
# With one of these a spreadsheet takes the text for a formula.
RUNS = ("=", "+", "-", "@", "\t", "\r", "\n")

Object = Mapping[str, object]


class ListQuery(Struct, forbid_unknown_fields=True):
    """Filters and size of a list; `before` continues where an earlier answer ended."""

    robot: Label | UnsetType = UNSET
    since: Annotated[GivenTimestamp, Meta(description="From this time on")] | UnsetType = UNSET
    until: Annotated[GivenTimestamp, Meta(description="Before this time")] | UnsetType = UNSET
    before: (
        Annotated[int, Meta(ge=1, le=MAX_ID, description="Continue after the entry with this id")]
        | UnsetType
    ) = UNSET
    limit: Limit | UnsetType = UNSET
    format: Annotated[Format, Meta(description=FORMAT_WORDS)] | UnsetType = UNSET


class Numbered(Protocol):
    """A record that has a number."""

    @property
    def id(self) -> int:
        """The number, by which the records are in order."""


R = TypeVar("R", bound=Numbered)


def everything(fetch: Callable[[int | None, int], list[R]], limit: int | None) -> Iterator[R]:
    """Return one record after the other, `limit` at most.

    `fetch` returns up to the given number, the newest first, that come before the one with this id.
    """
    before: int | None = None
    left = limit
    while left is None or left > 0:
        count = PIECE if left is None else min(PIECE, left)
        records = fetch(before, count)
        yield from records
        if len(records) < count:
            return
        before = records[-1].id
        left = None if left is None else left - len(records)


def download(
    find: Callable[..., list[R]],
    kind: Format,
    *,
    columns: Sequence[str],
    filename: str,
    before: int | None = None,
    limit: int | None = None,
) -> Response:
    """Stream what `find(tx, viewer, before=..., limit=...)` finds, each piece in a transaction of its own.

    Each is for the user of the request's login or token as they are then: a slow reader must not outlive a right.
    """
    database = context().database

    def fetch(last: int | None, count: int) -> list[R]:
        with database.transaction() as tx:
            viewer = auth.credential_user(tx, request, renew=False)
            return find(tx, viewer, before=before if last is None else last, limit=count)

    response = answer(map(plain, everything(fetch, limit)), columns, kind, filename)
    response.response = stream_with_context(response.iter_encoded())
    return response


def answer(
    records: Iterable[Object], columns: Sequence[str], kind: Format, filename: str
) -> Response:
    """Return a response that streams the records; what fails at the first of them fails here."""
    following = iter(records)
    first = list(islice(following, 1))
    every = chain(first, following)
    lines = (
        _csv_lines(every, columns)
        if kind == "csv"
        else (json.dumps(record) + "\n" for record in every)
    )
    response = Response(lines, content_type=TYPES[kind])
    response.headers["Content-Disposition"] = f'attachment; filename="{filename}.{kind}"'
    return response


def _csv_lines(records: Iterable[Object], columns: Sequence[str]) -> Iterator[str]:
    yield _csv_line(columns)
    for record in records:
        yield _csv_line([_cell(record.get(column)) for column in columns])


def _csv_line(cells: Sequence[str]) -> str:
    line = io.StringIO()
    csv.writer(line).writerow(cells)
    return line.getvalue()


def _cell(value: object) -> str:
    """Return the text of a cell; one that a spreadsheet would run begins with an apostrophe."""
    if value is None:
        return ""
    if isinstance(value, str):
        return "'" + value if value.startswith(RUNS) else value
    return json.dumps(value)
