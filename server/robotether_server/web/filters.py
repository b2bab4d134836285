"""Long lists: their pages and files, the filters in the query, and the links that keep them."""

import datetime as dt
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from http import HTTPStatus
from typing import Generic, cast
from urllib.parse import urlencode

from flask import Blueprint, Response, render_template, request

from robotether_server import schemas, times
from robotether_server.api import exports
from robotether_server.api.context import context
from robotether_server.api.exports import R
from robotether_server.db import Transaction
from robotether_server.problems import FieldInvalidError
from robotether_server.web import current_user

LENGTH_OF_DAY_TEXT = 10
PER_PAGE = 50
# Number of rows to read: one more than a page shows, so that an older page is known.
ROWS_TO_READ = PER_PAGE + 1
Query = dict[str, str]
# What a filter offers, by its name: pairs of value and words.
FilterChoices = dict[str, list[tuple[str, str]]]


@dataclass(frozen=True)
class Page(Generic[R]):
    """What one page of a list shows, and where the others are."""

    rows: list[R]
    older: str | None
    newest: str | None


def register(
    blueprint: Blueprint,
    template: str,
    names: tuple[str, ...],
    finder: Callable[[Query], Callable[..., list[R]]],
    download: Callable[[Callable[..., list[R]], exports.Format], Response],
    *,
    offer: Callable[[Transaction], FilterChoices],
) -> None:
    """Make the page of a list, and /download, which sends all that matches as a file.

    `names` are those of the filters. `finder` returns what finds records, `find(tx, viewer, before=..., limit=...)`.
    """

    def show() -> str | tuple[str, int]:
        query = query_of(names)
        with context().database.transaction() as tx:
            values = {"query": query, "choices": offer(tx), "files": files(request.path, query)}
            try:
                rows = finder(query)(tx, current_user.get(), before=before(), limit=ROWS_TO_READ)
                listing = page(request.path, query, rows)
            except FieldInvalidError as problem:
                empty = Page[R]([], None, None)
                answer = render_template(template, page=empty, problem=problem, **values)
                return answer, HTTPStatus.UNPROCESSABLE_ENTITY
        return render_template(template, page=listing, **values)

    blueprint.add_url_rule("", "show", show)
    blueprint.add_url_rule(
        "/download", "save", lambda: download(finder(query_of(names)), file_kind())
    )


def query_of(names: tuple[str, ...]) -> Query:
    """Return the query's values of these names; a missing one is empty."""
    return {name: request.args.get(name, "").strip() for name in names}


def since(query: Query) -> dt.datetime | None:
    """Parse a start: a day in UTC, from its first second, or a time; raise FieldInvalidError."""
    text = query["since"]
    return times.day_or_timestamp("From", text, is_end=False) if text else None


def until(query: Query) -> dt.datetime | None:
    """Parse an exclusive end: a day in UTC, which is included, or a time; raise FieldInvalidError."""
    text = query["until"]
    if not text:
        return None
    end = times.day_or_timestamp("To", text, is_end=True)
    try:
        return end + dt.timedelta(seconds=1) if len(text) == LENGTH_OF_DAY_TEXT else end
    except OverflowError as error:
        raise FieldInvalidError("cannot use To: there is no day after it") from error


def link(path: str, query: Query, **more: object) -> str:
    """Return the path with what is asked for, and more."""
    text = urlencode({name: value for name, value in query.items() if value} | more)
    return f"{path}?{text}" if text else path


def before() -> int | None:
    """Return the id that the page ends before; None: it is the newest."""
    return request.args.get("before", type=int)


def page(path: str, query: Query, rows: list[R]) -> Page[R]:
    """Return what to show of the ROWS_TO_READ that were looked for."""
    records = rows[:PER_PAGE]
    older = link(path, query, before=records[-1].id) if len(rows) > PER_PAGE else None
    newest = link(path, query) if before() is not None else None
    return Page(records, older, newest)


def name_choices(names: Iterable[str]) -> list[tuple[str, str]]:
    """Return what a filter by name offers."""
    return [(name, name) for name in sorted(names)]


def files(path: str, query: Query) -> list[tuple[str, str]]:
    """Return the links to all that matches, by kind of file."""
    return [(kind, link(path + "/download", query, format=kind)) for kind in exports.FORMATS]


def file_kind() -> exports.Format:
    """Return which of them is asked for; raise FieldInvalidError."""
    kind = request.args.get("format", "")
    schemas.check("format", kind, exports.Format)
    return cast(exports.Format, kind)
