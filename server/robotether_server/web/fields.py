"""Typed getters for what comes from outside in JSON; every refusal names the field."""

from typing import TypeVar

from flask import Request

from robotether_server.problems import FieldInvalid

T = TypeVar("T", bound=str)


def json_object(request: Request) -> dict[str, object]:
    """Return the body of a request, which must be one JSON object."""
    body = request.get_json(force=True, silent=True)
    if not isinstance(body, dict):
        raise FieldInvalid("cannot read the body: it must be one JSON object")
    return body


def text(body: dict[str, object], name: str, longest: int) -> str:
    """Return a text of printable characters, without the white space around it."""
    value = body.get(name)
    cleaned = value.strip() if isinstance(value, str) else ""
    if not cleaned or len(cleaned) > longest or not cleaned.isprintable():
        raise FieldInvalid(
            f"cannot use {name}: it must be a text of 1 to {longest} printable characters"
        )
    return cleaned


def optional_text(body: dict[str, object], name: str, longest: int) -> str | None:
    """Return a text as `text` does, or None when it is missing or null."""
    return None if body.get(name) is None else text(body, name, longest)


def choice(body: dict[str, object], name: str, allowed: tuple[T, ...]) -> T:
    """Return one of the allowed texts."""
    for value in allowed:
        if body.get(name) == value:
            return value
    raise FieldInvalid(f"cannot use {name}: it must be one of {', '.join(allowed)}")
