"""Reads what comes from outside into a msgspec.Struct; every refusal names the field and says what it must be.

Used by the API for bodies and queries, and by services for single values. A text loses the white space around it and
has printable characters alone. What a value must be is said by its type (field_types.py) and nowhere else. Pure.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple, TypeVar, get_type_hints

import msgspec
from msgspec import inspect

from robotether_server import times
from robotether_server.problems import FieldInvalid

S = TypeVar("S", bound=msgspec.Struct)
# As many as 64 bits have.
MAX_DIGITS = 20


class Field(NamedTuple):
    """A member of a Struct: its name outside, its type, and what msgspec and `extra` know of that type."""

    name: str
    hint: Any
    kind: inspect.Type
    extra: Mapping[str, Any]
    may_be_null: bool
    is_required: bool


def read_body(given: Mapping[str, object], hint: Any) -> Any:
    """Return the Struct of these members, at least one if its type says so; raise FieldInvalid."""
    kind: Any = _info(hint)
    least = 0
    if isinstance(kind, inspect.Metadata):
        kind, least = kind.type, (kind.extra_json_schema or {}).get("minProperties", 0)
    if isinstance(kind, inspect.DictType):
        # The service that takes it reads it.
        return given
    found = read(given, kind.cls)
    if len(given) < least:
        names = ", ".join(field.name for field in _fields(kind.cls).values())
        raise FieldInvalid(f"cannot change anything: give one of {names}")
    return found


def read(given: Mapping[str, object], kind: type[S], path: str = "") -> S:
    """Return the Struct of these members; raise FieldInvalid. `path` is where they stand, with a dot at its end."""
    known = _fields(kind)
    if kind.__struct_config__.forbid_unknown_fields:
        _check_known(given, [field.name for field in known.values()])
    values = {
        attribute: _read_field(given.get(field.name), field, path)
        for attribute, field in known.items()
        if field.name in given or field.is_required
    }
    return kind(**values)


def read_query(given: Mapping[str, str], kind: type[S]) -> S:
    """Return the Struct of a query, whose numbers are written in decimal digits; raise FieldInvalid."""
    known = {field.name: field for field in _fields(kind).values()}
    plain: dict[str, object] = {
        name: _number(text, known[name]) if name in known else text for name, text in given.items()
    }
    return read(plain, kind)


def check(name: str, value: object, hint: Any) -> None:
    """Raise FieldInvalid unless the value is as its type says, without white space around it."""
    field = _field(name, hint, _info(hint), is_required=True)
    if _read_field(value, field, "") != value:
        raise _refusal(name, field)


def _check_known(given: Mapping[str, object], known: list[str]) -> None:
    """Raise FieldInvalid for a member that nobody would read, such as a misspelt one."""
    for name in given:
        if name not in known:
            raise FieldInvalid(
                f"cannot use {name[:40]!r}: there is no such field; known are {', '.join(known)}"
            )


@cache
def _fields(kind: type[msgspec.Struct]) -> Mapping[str, Field]:
    """Return the members by their attributes."""
    hints = get_type_hints(kind, include_extras=True)
    return {
        one.name: _field(one.encode_name, hints[one.name], one.type, is_required=one.required)
        for one in _info(kind).fields
    }


@cache
def _info(hint: Any) -> Any:
    return inspect.type_info(hint)


def _field(name: str, hint: Any, kind: inspect.Type, *, is_required: bool) -> Field:
    extra: dict[str, Any] = {}
    may_be_null = False
    while isinstance(kind, inspect.Metadata | inspect.UnionType):
        if isinstance(kind, inspect.Metadata):
            extra |= kind.extra or {}
            kind = kind.type
        else:
            [other] = [one for one in kind.types if not isinstance(one, inspect.NoneType)]
            may_be_null, kind = len(kind.types) > 1, other
    return Field(name, hint, kind, extra, may_be_null, is_required)


def _read_field(value: object, field: Field, path: str) -> object:
    name = f"{path}{field.name}"
    if value is None and field.may_be_null:
        return None
    if isinstance(field.kind, inspect.StructType) and isinstance(value, dict):
        return read(value, field.kind.cls, f"{name}.")
    try:
        value = _cleaned(value, field)
        if isinstance(field.kind, inspect.DateTimeType):
            return times.timestamp(name, str(value))
        return msgspec.convert(value, field.hint)
    except (ValueError, msgspec.ValidationError) as error:
        raise _refusal(name, field) from error


def _cleaned(value: object, field: Field) -> object:
    """Return a text without the white space around it, and 5.0 as 5; raise ValueError for another type."""
    if isinstance(field.kind, inspect.IntType):
        return _whole(value, field)
    if not isinstance(field.kind, inspect.StrType | inspect.DateTimeType):
        return value
    if not isinstance(value, str):
        raise ValueError("no text")  # noqa: TRY004 - as for all else that is wrong with it
    if field.extra.get("as_typed"):
        # Half of a pair of surrogates, which JSON can spell, is no character.
        value.encode()
        text = value
    else:
        text = value.strip()
        if not text or not text.isprintable():
            raise ValueError("empty or not printable")
        if len(value) > _longest(field):
            raise ValueError("too long")
    return text


def _whole(value: object, field: Field) -> object:
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if "most" in field.extra and isinstance(value, int) and value > field.extra["most"]:
        raise ValueError("too large")
    return value


def _longest(field: Field) -> int:
    if isinstance(field.kind, inspect.DateTimeType):
        return times.MAX_TEXT_LENGTH
    # A text without either is a mistake in its type.
    return int(field.extra.get("longest") or field.kind.max_length)  # type: ignore[attr-defined] # it is a StrType


def _number(text: str, field: Field) -> object:
    # Python takes digits of every script, underscores and signs for a number; and long texts are slow to read.
    is_plain = text.isascii() and text.isdigit() and len(text) <= MAX_DIGITS
    return int(text) if isinstance(field.kind, inspect.IntType) and is_plain else text


def _refusal(name: str, field: Field) -> FieldInvalid:
    return FieldInvalid(f"cannot use {name}: it must be {_must_be(field)}")


def _must_be(field: Field) -> str:
    """Return what the field must be, as the end of a sentence."""
    kind, extra = field.kind, field.extra
    must = "a text" if extra.get("as_typed") else "a JSON object"
    match kind:
        case inspect.StrType() if not extra.get("as_typed"):
            must = f"a text of 1 to {_longest(field)} printable characters"
        case inspect.DateTimeType():
            must = times.MUST_BE
        case inspect.IntType():
            must = f"a whole number from {kind.ge} to {extra.get('most', kind.le)}"
        case inspect.LiteralType():
            must = f"one of {', '.join(map(str, kind.values))}"
        case inspect.BoolType():
            must = "true or false"
        case inspect.ListType():
            must = "a list"
    return str(extra.get("must", must))
