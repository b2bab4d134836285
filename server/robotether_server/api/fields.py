"""Typed getters for what comes from outside in JSON or in a query; every refusal names the field."""

import datetime as dt
from collections.abc import Collection
from http import HTTPStatus
from typing import TypeVar

from flask import Request

from robotether_server import times
from robotether_server.problems import FieldInvalid, HttpProblem

T = TypeVar("T", bound=str)
Fields = dict[str, object]


def json_object(
    request: Request, known: Collection[str] | None = None, *, any_type: bool = False
) -> Fields:
    """Return the body of a request, which must be one JSON object; with no other members than `known`, if given.

    Raises FieldInvalid, or HttpProblem with 415 for a body that is not sent as JSON. `any_type`: whatever it
    calls itself, as `curl -d` sends it.
    """
    if not any_type and not request.is_json:
        raise HttpProblem(
            HTTPStatus.UNSUPPORTED_MEDIA_TYPE,
            "cannot read the body: send one JSON object, with Content-Type: application/json",
        )
    try:
        body = request.get_json(force=True, silent=True)
    except RecursionError:
        body = None
    if not isinstance(body, dict):
        raise FieldInvalid("cannot read the body: it must be one JSON object")
    if known is not None:
        check_known(body, known)
    return body


def query(request: Request, known: Collection[str]) -> Fields:
    """Return what stands in a request's query, each name once; raise FieldInvalid."""
    for name, values in request.args.lists():
        if len(values) > 1:
            raise FieldInvalid(f"cannot use {name[:40]!r}: it appears in the query more than once")
    given: Fields = dict(request.args.items())
    check_known(given, known)
    return given


def check_known(given: Fields, known: Collection[str]) -> None:
    """Raise FieldInvalid for a member that nobody would read, such as a misspelt one."""
    for name in given:
        if name not in known:
            raise FieldInvalid(
                f"cannot use {name[:40]!r}: there is no such field; known are {', '.join(known)}"
            )


def text(body: Fields, name: str, longest: int) -> str:
    """Return a text of printable characters, without the white space around it."""
    value = body.get(name)
    cleaned = value.strip() if isinstance(value, str) and len(value) <= longest else ""
    if not cleaned or not cleaned.isprintable():
        raise FieldInvalid(
            f"cannot use {name}: it must be a text of 1 to {longest} printable characters"
        )
    return cleaned


def optional_text(body: Fields, name: str, longest: int) -> str | None:
    """Return a text as `text` does, or None when it is missing or null."""
    return None if body.get(name) is None else text(body, name, longest)


def secret(body: Fields, name: str) -> str:
    """Return a text as it was typed; whoever takes it judges its length."""
    value = body.get(name)
    # Half of a pair of surrogates, which JSON can spell, is no character.
    if not isinstance(value, str) or any("\ud800" <= letter <= "\udfff" for letter in value):
        raise FieldInvalid(f"cannot use {name}: it must be a text")
    return value


def choice(body: Fields, name: str, allowed: tuple[T, ...]) -> T:
    """Return one of the allowed texts."""
    for value in allowed:
        if body.get(name) == value:
            return value
    raise FieldInvalid(f"cannot use {name}: it must be one of {', '.join(allowed)}")


def number(body: Fields, name: str, lowest: int, highest: int) -> int:
    """Return a whole number from `lowest` to `highest`, which may be written as 5 or as 5.0."""
    value = body.get(name)
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    # True and False are numbers to Python, and not to JSON.
    if isinstance(value, bool) or not isinstance(value, int) or not lowest <= value <= highest:
        raise FieldInvalid(
            f"cannot use {name}: it must be a whole number from {lowest} to {highest}"
        )
    return value


def number_in_query(given: Fields, name: str, lowest: int, highest: int) -> int | None:
    """Return a whole number that is written in decimal digits, or None when there is none."""
    value = given.get(name)
    if value is None:
        return None
    is_plain = isinstance(value, str) and value.isascii() and value.isdigit()
    # Longer texts are out of any bounds, and slow to read.
    read = int(str(value)) if is_plain and len(str(value)) <= len(str(highest)) else None
    return number({name: read}, name, lowest, highest)


def optional_timestamp(body: Fields, name: str) -> dt.datetime | None:
    """Return a moment of RFC 3339, or None when it is missing or null."""
    value = optional_text(body, name, times.MAX_TEXT_LENGTH)
    return None if value is None else times.timestamp(name, value)


def flag(body: Fields, name: str) -> bool:
    """Return true or false."""
    value = body.get(name)
    if not isinstance(value, bool):
        raise FieldInvalid(f"cannot use {name}: it must be true or false")
    return value


def mapping(body: Fields, name: str) -> Fields:
    """Return a JSON object."""
    value = body.get(name)
    if not isinstance(value, dict):
        raise FieldInvalid(f"cannot use {name}: it must be a JSON object")
    return value
