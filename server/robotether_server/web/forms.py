"""Typed getters for what people fill into forms; every refusal names the field by its label."""

from typing import TypeVar

from flask import request

from robotether_server.problems import FieldInvalid

T = TypeVar("T", bound=str)


def text(name: str, label: str, longest: int) -> str:
    """Return a text of printable characters, without the white space around it."""
    value = optional_text(name, label, longest)
    if value is None:
        raise FieldInvalid(f"cannot continue: fill in {label}", name)
    return value


def optional_text(name: str, label: str, longest: int) -> str | None:
    """Return a text as `text` does, or None when the field is empty."""
    value = request.form.get(name, "").strip()
    if len(value) > longest or not value.isprintable():
        raise FieldInvalid(
            f"cannot use {label}: at most {longest} printable characters are allowed", name
        )
    return value or None


def secret(name: str) -> str:
    """Return a password as it was typed."""
    return request.form.get(name, "")


def number(name: str, label: str, lowest: int, highest: int) -> int:
    """Return a whole number within the bounds, both included."""
    value = optional_number(name, label, lowest, highest)
    if value is None:
        raise FieldInvalid(f"cannot continue: fill in {label}", name)
    return value


def optional_number(name: str, label: str, lowest: int, highest: int) -> int | None:
    """Return a number as `number` does, or None when the field is empty."""
    value = request.form.get(name, "").strip()
    if not value:
        return None
    # Python takes digits of every script and underscores for a number; people mean neither.
    is_number = value.isascii() and value.isdigit() and len(value) <= len(str(highest))
    if not is_number or not lowest <= int(value) <= highest:
        raise FieldInvalid(
            f"cannot use {label}: it must be a whole number from {lowest} to {highest}", name
        )
    return int(value)


def choice(name: str, label: str, allowed: tuple[T, ...]) -> T:
    """Return one of the allowed texts."""
    for value in allowed:
        if request.form.get(name) == value:
            return value
    raise FieldInvalid(f"cannot use {label}: choose one of {', '.join(allowed)}", name)


def is_ticked(name: str) -> bool:
    """Tell whether a checkbox is ticked."""
    return bool(request.form.get(name))
