"""What the fields of requests, records and answers hold, and how input is parsed into them.

Each name is a type for msgspec, by which `api.description` describes, too. `extra` says what JSON Schema does not:
`longest` where the pattern alone describes the length, `most` for a bound of more than 63 bits, `must` for the end of
"it must be ...", `as_typed` for a text that keeps its white space. Used by the API for bodies and queries, and by
services for single values. A text loses the white space around it and has printable characters alone; every refusal
names the field and says what it must be. Pure.
"""

import datetime as dt
import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, get_type_hints

import msgspec
from msgspec import Meta, inspect
from robotether_common.ros import GLOB_PATTERN, MAX_GLOB_LENGTH, MAX_GLOBS, Globs, is_glob
from robotether_common.ros import MAX_NAME_LENGTH as MAX_ROS_NAME_LENGTH

from robotether_server import identity, times
from robotether_server.problems import FieldInvalidError

MAX_NAME_LENGTH = 63
PLAIN_NAME_PATTERN = "^[a-z0-9][a-z0-9._-]{0,62}$"
ROBOT_NAME_PATTERN = "^[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?$"

# Maximum number of digits, those of 64 bits.
MAX_DIGITS = 20

S = TypeVar("S", bound=msgspec.Struct)

# What a grant allows.
Level = Literal["observe", "drive", "manage"]

# A name that people choose.
Label = Annotated[
    str, Meta(min_length=1, max_length=MAX_NAME_LENGTH, description="Printable characters")
]
# For a new group or site: it is part of paths.
NewPlainName = Annotated[
    str,
    Meta(
        max_length=MAX_NAME_LENGTH,
        pattern=PLAIN_NAME_PATTERN,
        extra={
            "must": f"1 to {MAX_NAME_LENGTH} characters a-z, 0-9, ., _ and -, and begin with a letter or a digit"
        },
    ),
]
# Names of what is there: one that nobody can have is not found, so the pattern is described and not checked.
RobotName = Annotated[
    str,
    Meta(
        extra_json_schema={"pattern": ROBOT_NAME_PATTERN, "examples": ["turtle"]},
        extra={"longest": MAX_NAME_LENGTH},
    ),
]
# A web app of a user.
AppName = Annotated[
    str,
    Meta(
        max_length=MAX_NAME_LENGTH,
        pattern=ROBOT_NAME_PATTERN,
        extra={"must": f"1 to {MAX_NAME_LENGTH} characters a-z, 0-9 and -, with no - at its ends"},
    ),
]
# Before the name of an end of a route that is a web app of who makes it; no robot has such a name.
APP = "app:"
RouteEndName = Annotated[
    str,
    Meta(
        description=f"A robot's name, or {APP}NAME for a web app of who makes the route",
        extra_json_schema={
            "pattern": f"^({APP})?{ROBOT_NAME_PATTERN.removeprefix('^')}",
            "examples": ["turtle"],
        },
        extra={"longest": MAX_NAME_LENGTH + len(APP)},
    ),
]
UserName = Annotated[
    str,
    Meta(extra_json_schema={"pattern": PLAIN_NAME_PATTERN}, extra={"longest": MAX_NAME_LENGTH}),
]
PlainName = Annotated[
    str,
    Meta(
        extra_json_schema={"pattern": PLAIN_NAME_PATTERN, "maxLength": MAX_NAME_LENGTH},
        extra={"longest": MAX_NAME_LENGTH},
    ),
]
Fingerprint = Annotated[
    str,
    Meta(
        min_length=1,
        max_length=64,
        extra_json_schema={"examples": ["SHA256:47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU"]},
    ),
]
PublicKeyLine = Annotated[
    str,
    Meta(
        min_length=1,
        max_length=identity.MAX_KEY_LENGTH,
        description="One line as in a .pub file, without options",
        extra_json_schema={"examples": [identity.EXAMPLE_KEY]},
    ),
]
Signature = Annotated[
    str,
    Meta(
        description="SSHSIG: of the key over token, MAC and key; in previous_key of that key over MAC and new key",
        extra={
            "as_typed": True,
            "longest": identity.MAX_SIGNATURE_LENGTH,
            "must": "a text, no longer than that of an ssh-ed25519 key",
        },
    ),
]
# Robots spell their MAC in several ways; identity.normalise_mac checks it.
Mac = Annotated[
    str,
    Meta(
        max_length=identity.MAX_MAC_LENGTH,
        description="MAC address of a network card, in any usual spelling",
        extra_json_schema={"minLength": 11, "examples": ["00:1b:44:11:3a:b7"]},
    ),
]
Hostname = Annotated[str, Meta(min_length=1, max_length=253)]
AgentVersion = Annotated[str, Meta(min_length=1, max_length=32)]
Count = Annotated[int, Meta(ge=0)]
Amount = Annotated[float, Meta(ge=0)]
Timestamp = Annotated[dt.datetime, Meta(tz=True)]
# In a request.
GivenTimestamp = Annotated[
    dt.datetime, Meta(tz=True, extra_json_schema={"maxLength": times.MAX_TEXT_LENGTH})
]


def setting(title: str, description: str | None = None, **extra: object) -> Meta:
    """Return what forms and the API's description say of a setting; `extra` is for web/pages/setting_fields.py."""
    return Meta(title=title, description=description, extra=extra)


def read_globs(raw: object, path: str) -> Globs:
    """Return patterns for names; raise FieldInvalidError."""
    if not isinstance(raw, list | tuple) or len(raw) > MAX_GLOBS:
        raise FieldInvalidError(
            f"cannot use {path}: it must be a list of at most {MAX_GLOBS} names", path
        )
    for pattern in raw:
        if not isinstance(pattern, str) or not is_glob(pattern):
            raise FieldInvalidError(
                f"cannot use {path}: {str(pattern)[:40]!r} is not a full name, such as /arm/move or */cmd_vel; a "
                f"name begins with / or *, has a-z, A-Z, 0-9, _, / and * and at most {MAX_GLOB_LENGTH} characters",
                path,
            )
    return Globs(dict.fromkeys(raw))


GLOBS_SCHEMA = {
    "type": "array",
    "maxItems": MAX_GLOBS,
    "items": {"type": "string", "pattern": GLOB_PATTERN, "maxLength": MAX_GLOB_LENGTH},
    "description": "Names, in which * stands for any text",
}
GivenGlobs = Annotated[Globs, Meta(extra_json_schema=GLOBS_SCHEMA, extra={"read": read_globs})]
# As the relay takes names in messages (relay/channels/rosbridge/operations.py), with their first `/`.
RosName = Annotated[
    str,
    Meta(
        max_length=MAX_ROS_NAME_LENGTH,
        pattern="^(/[A-Za-z0-9_]+)+$",
        extra={
            "exact": True,
            "must": "a full name such as /arm/move_1, of a-z, A-Z, 0-9, _ and /, and at most "
            f"{MAX_ROS_NAME_LENGTH} characters",
        },
    ),
]
# Of a body with changes.
AT_LEAST_ONE = Meta(extra_json_schema={"minProperties": 1})


class StructField(NamedTuple):
    """A member of a Struct: its name outside, its type, its `words` for JSON Schema, and the `extra` of that type."""

    name: str
    hint: Any
    kind: Any
    words: Mapping[str, Any]
    extra: Mapping[str, Any]
    may_be_null: bool
    is_required: bool


def read_body(raw: Mapping[str, object], hint: Any) -> Any:
    """Return the Struct of these members, at least one if its type says so; raise FieldInvalidError."""
    kind: Any = _info(hint)
    least = 0
    if isinstance(kind, inspect.Metadata):
        kind, least = kind.type, (kind.extra_json_schema or {}).get("minProperties", 0)
    if isinstance(kind, inspect.DictType):
        # The service that takes it reads it.
        return raw
    body = read(raw, kind.cls)
    if len(raw) < least:
        names = ", ".join(field.name for field in _fields(kind.cls).values())
        raise FieldInvalidError(f"cannot change anything: give one of {names}")
    return body


def read(raw: Mapping[str, object], kind: type[S], path: str = "", *, of: str = "") -> S:
    """Return the Struct of these members; raise FieldInvalidError.

    `path` is where they are, with a dot at its end; `of` names what they are the settings of.
    """
    fields = _fields(kind)
    config = kind.__struct_config__
    if config.forbid_unknown_fields:
        tag = [config.tag_field] if config.tag_field else []
        _check_names(raw, [*tag, *(field.name for field in fields.values())], of or path[:-1])
    values = {
        attribute: _read_field(raw.get(field.name), field, path)
        for attribute, field in fields.items()
        if field.name in raw or field.is_required
    }
    return kind(**values)


def read_query(raw: Iterable[tuple[str, str]], kind: type[S]) -> S:
    """Return the Struct of a query, whose numbers are written in decimal digits; raise FieldInvalidError."""
    fields = {field.name: field for field in _fields(kind).values()}
    plain: dict[str, object] = {}
    for name, text in raw:
        if name in plain:
            raise FieldInvalidError(
                f"cannot use {name[:40]!r}: it appears in the query more than once"
            )
        plain[name] = _number(text, fields[name]) if name in fields else text
    return read(plain, kind)


def value(name: str, raw: object, hint: Any) -> Any:
    """Return the value converted to its type; raise FieldInvalidError."""
    return _read_field(raw, _field(name, hint, _info(hint), is_required=True), "")


def check(name: str, raw: object, hint: Any) -> None:
    """Raise FieldInvalidError unless the value is as its type says, without white space around it."""
    field = _field(name, hint, _info(hint), is_required=True)
    if _read_field(raw, field, "") != raw:
        raise _refusal(name, field)


def member(kind: type[msgspec.Struct], path: str) -> StructField:
    """Return a member of a Struct or of those in it, by a path such as guard.deadman_ms."""
    first, dot, rest = path.partition(".")
    field = _fields(kind)[first]
    return member(field.kind.cls, rest) if dot else field


def words(kind: type[msgspec.Struct]) -> Mapping[str, Mapping[str, Any]]:
    """Return the words of a Struct's members, such as their `title`."""
    return {name: field.words for name, field in _fields(kind).items()}


def _check_names(raw: Mapping[str, object], fields: list[str], of: str) -> None:
    """Raise FieldInvalidError for a member that nobody would read, such as a misspelt one."""
    for key in raw:
        if key not in fields:
            name = repr(str(key)[:40])
            names = ", ".join(fields)
            if of:
                raise FieldInvalidError(
                    f"cannot use {of}: {name} is not a setting; there is {names}"
                )
            raise FieldInvalidError(f"cannot use {name}: there is no such field; known are {names}")


@cache
def _fields(kind: type[msgspec.Struct]) -> Mapping[str, StructField]:
    """Return the members by their attributes."""
    hints = get_type_hints(kind, include_extras=True)
    return {
        field.name: _field(
            field.encode_name, hints[field.name], field.type, is_required=field.required
        )
        for field in _info(kind).fields
    }


@cache
def _info(hint: Any) -> Any:
    return inspect.type_info(hint)


def _field(name: str, hint: Any, kind: inspect.Type, *, is_required: bool) -> StructField:
    words: dict[str, Any] = {}
    extra: dict[str, Any] = {}
    may_be_null = False
    while True:
        if isinstance(kind, inspect.Metadata):
            words |= kind.extra_json_schema or {}
            extra |= kind.extra or {}
            kind = kind.type
        elif isinstance(kind, inspect.UnionType) and kind.includes_none:
            [kind] = [option for option in kind.types if not isinstance(option, inspect.NoneType)]
            may_be_null = True
        else:
            return StructField(name, hint, kind, words, extra, may_be_null, is_required)


def _read_field(raw: object, field: StructField, path: str) -> object:
    name, kind = f"{path}{field.name}", field.kind
    if raw is None and field.may_be_null:
        return None
    if "read" in field.extra:
        return field.extra["read"](raw, name)
    if isinstance(kind, inspect.StructType | inspect.UnionType):
        if not isinstance(raw, Mapping):
            raise _refusal(name, field)
        return read(raw, _struct(raw, kind, name), f"{name}.")
    if _has_structs(kind) and isinstance(raw, list | tuple):
        return _read_items(raw, field, name)
    try:
        cleaned = _cleaned(raw, field)
        if isinstance(kind, inspect.DateTimeType):
            return times.timestamp(name, str(cleaned))
        return msgspec.convert(cleaned, field.hint)
    except (ValueError, OverflowError, msgspec.ValidationError) as error:
        raise _refusal(name, field) from error


def _has_structs(kind: inspect.Type) -> bool:
    return isinstance(kind, inspect.ListType | inspect.VarTupleType) and isinstance(
        kind.item_type, inspect.StructType | inspect.UnionType
    )


def _struct(raw: Mapping[str, object], kind: Any, name: str) -> Any:
    """Return the Struct for an object: of several, the one with its tag."""
    if isinstance(kind, inspect.StructType):
        return kind.cls
    tags = {struct.tag: struct for struct in kind.types}
    tag_field = kind.types[0].tag_field
    tag = raw.get(tag_field)
    if not isinstance(tag, str) or tag not in tags:
        raise FieldInvalidError(
            f"cannot use {name}.{tag_field}: it must be one of {', '.join(tags)}"
        )
    return tags[tag].cls


def _read_items(raw: Sequence[object], field: StructField, name: str) -> object:
    kind: Any = field.kind
    if kind.max_length is not None and len(raw) > kind.max_length:
        raise _refusal(name, field)
    items = [
        _read_field(item, _field(str(place), Any, kind.item_type, is_required=True), f"{name}.")
        for place, item in enumerate(raw, 1)
    ]
    return tuple(items) if isinstance(kind, inspect.VarTupleType) else items


def _cleaned(raw: object, field: StructField) -> object:
    """Return a text without the white space around it, and 5.0 as 5; raise ValueError for what cannot be meant."""
    if isinstance(field.kind, inspect.StrType | inspect.DateTimeType):
        return _text(raw, field)
    if isinstance(field.kind, inspect.FloatType) and isinstance(raw, float):
        if not math.isfinite(raw):
            raise ValueError("no number of JSON")
    elif isinstance(field.kind, inspect.IntType | inspect.LiteralType):
        if isinstance(raw, float) and raw.is_integer():
            raw = int(raw)
        if "most" in field.extra and isinstance(raw, int) and raw > field.extra["most"]:
            raise ValueError("too large")
    return raw


def _text(raw: object, field: StructField) -> str:
    if not isinstance(raw, str):
        raise ValueError("no text")  # noqa: TRY004 - as for all else that is wrong with it
    extra = field.extra
    if extra.get("as_typed"):
        # Half of a pair of surrogates, which JSON can spell, is no character.
        raw.encode()
        if len(raw) > extra.get("longest", len(raw)):
            raise ValueError("too long")
        return raw
    text = raw.strip()
    if len(raw) > _longest(field) or not text or not text.isprintable():
        raise ValueError("too long, empty or not printable")
    if extra.get("exact") and text != raw:
        raise ValueError("white space around it")
    return text


def _longest(field: StructField) -> int:
    if isinstance(field.kind, inspect.DateTimeType):
        return times.MAX_TEXT_LENGTH
    # A text without either is a mistake in its type.
    return int(field.extra.get("longest") or field.kind.max_length)


def _number(text: str, field: StructField) -> object:
    # Python takes digits of every script, underscores and signs for a number; and long texts are slow to read.
    is_plain = text.isascii() and text.isdigit() and len(text) <= MAX_DIGITS
    return int(text) if isinstance(field.kind, inspect.IntType) and is_plain else text


def _refusal(name: str, field: StructField) -> FieldInvalidError:
    return FieldInvalidError(f"cannot use {name}: it must be {_must_be(field)}", name)


def _must_be(field: StructField) -> str:
    """Return what the field must be, as the end of a sentence."""
    kind, extra = field.kind, field.extra
    null = "null or " if field.may_be_null else ""
    must = "a text" if extra.get("as_typed") else "a JSON object"
    match kind:
        case inspect.StrType() if not extra.get("as_typed"):
            must = f"a text of 1 to {_longest(field)} printable characters"
        case inspect.DateTimeType():
            must = times.MUST_BE
        case inspect.IntType():
            must = f"a whole number from {kind.ge} to {extra.get('most', kind.le)}"
        case inspect.FloatType():
            must = f"a number from {kind.ge:g} to {kind.le:g}"
        case inspect.LiteralType():
            must = f"one of {', '.join(map(str, kind.values))}"
        case inspect.BoolType():
            must = "true or false"
        case inspect.ListType() | inspect.VarTupleType():
            must = f"a list of at most {kind.max_length}"
    return null + str(extra.get("must", must))
