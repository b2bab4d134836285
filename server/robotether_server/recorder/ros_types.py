"""Message types as a robot's rosapi describes them, or as ROS 2 writes them, and their definitions for a file.

Whatever the robot's ROS is, a file has the types of ROS 2: its time and header, and none of ROS 1. Pure.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from robotether_server.problems import RobotetherError

# Names in a definition, which come from a robot; anything else could write lines of its own into it.
FIELD_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,127}")
TYPE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,127}/[A-Za-z][A-Za-z0-9_]{0,127}")
# Maximum number of types in a definition, and of fields of all of them: they are read while all robots wait.
MAX_TYPES, MAX_FIELDS = 200, 2000
MAX_ARRAY = 1_000_000
# Maximum length of a definition, which each file has once for each type.
MAX_DEFINITION = 100_000
SEPARATOR = "=" * 80

PRIMITIVES = frozenset(
    [
        "bool",
        "byte",
        "char",
        "float32",
        "float64",
        "string",
        "int8",
        "uint8",
        "int16",
        "uint16",
        "int32",
        "uint32",
        "int64",
        "uint64",
    ]
)
# Names that ROS 2's own Python packages, or ROS 1, give to types of a definition.
SPELLINGS = {
    "boolean": "bool",
    "octet": "byte",
    "float": "float32",
    "double": "float64",
    "time": "builtin_interfaces/Time",
    "duration": "builtin_interfaces/Duration",
    "Header": "std_msgs/Header",
    "roslib/Header": "std_msgs/Header",
}


class RosField(NamedTuple):
    """A field; `length` is None of a single value, 0 of a sequence, else that of an array."""

    name: str
    type: str
    length: int | None = None


# By the short name of a type, such as geometry_msgs/Twist.
RosTypes = Mapping[str, tuple[RosField, ...]]

_STAMP = (RosField("sec", "int32"), RosField("nanosec", "uint32"))
BUILT_IN: RosTypes = {
    "builtin_interfaces/Time": _STAMP,
    "builtin_interfaces/Duration": _STAMP,
    "std_msgs/Header": (
        RosField("stamp", "builtin_interfaces/Time"),
        RosField("frame_id", "string"),
    ),
}


class UnknownTypeError(RobotetherError):
    """Nobody can say how messages of a type are made up."""


@dataclass(frozen=True)
class RosType:
    """A message type with all that it consists of."""

    name: str
    types: RosTypes

    @property
    def full_name(self) -> str:
        """Its name in ROS 2, such as geometry_msgs/msg/Twist."""
        return self.name.replace("/", "/msg/")

    def definition(self) -> str:
        """Return its definition as `ros2msg`: its own fields, and those of each type in it."""
        inner = (
            f"{SEPARATOR}\nMSG: {name}\n{_lines(self.types[name])}"
            for name in _inner(self.name, self.types)
        )
        return "".join((_lines(self.types[self.name]), *inner))


def short_name(name: str) -> str:
    """Return a type's name without the `msg` of ROS 2, and by ROS 2's own spelling."""
    package, _, last = name.rpartition("/")
    plain = f"{package.removesuffix('/msg')}/{last}" if package else last
    return SPELLINGS.get(plain, plain)


def type_of(name: str, typedefs: object) -> RosType:
    """Return the type of this name by rosapi's answer to `message_details`; raise UnknownTypeError."""
    types = dict(BUILT_IN)
    for typedef in _objects(typedefs, MAX_TYPES):
        key = short_name(str(typedef.get("type")))
        if TYPE_NAME.fullmatch(key) and key not in BUILT_IN:
            types[key] = tuple(_fields(typedef))
        if sum(map(len, types.values())) > MAX_FIELDS:
            raise UnknownTypeError("types with too many fields")
    return checked(short_name(name), types)


def checked(name: str, types: RosTypes) -> RosType:
    """Return the type if all that it consists of is known, and none of it is a part of itself."""
    if name not in types:
        raise UnknownTypeError(name)
    _check(name, types, (), set(PRIMITIVES))
    ros_type = RosType(name, types)
    if len(ros_type.definition()) > MAX_DEFINITION:
        raise UnknownTypeError("a definition that is too long")
    return ros_type


def parse_definition(name: str, text: str) -> RosType:
    """Return the type of a definition of our own: a line a field, with built-in types alone."""
    lines = [line.partition("#")[0].split() for line in text.splitlines()]
    fields = tuple(_parse_field(line[1], line[0]) for line in lines if line)
    return checked(name, {**BUILT_IN, name: fields})


def _fields(typedef: Mapping[str, Any]) -> Iterator[RosField]:
    members: list[Any] = [typedef.get(key) for key in ("fieldnames", "fieldtypes", "fieldarraylen")]
    if not all(isinstance(member, list) for member in members):
        raise UnknownTypeError("a type without fields")
    names, kinds, lengths = members
    if not len(names) == len(kinds) == len(lengths) <= MAX_FIELDS:
        raise UnknownTypeError("a type whose fields do not fit each other")
    for name, kind, length in zip(names, kinds, lengths, strict=True):
        field = _parse_field(str(name), str(kind))
        if field.length is None and isinstance(length, int) and 0 <= length <= MAX_ARRAY:
            field = field._replace(length=length)
        yield field


def _parse_field(name: str, kind: str) -> RosField:
    """Read a field by any spelling of its type: uint8[], float64[36], string<10>, sequence<double, 3>."""
    if not FIELD_NAME.fullmatch(name):
        raise UnknownTypeError("a field with another name than ROS has")
    length: int | None = None
    if sequence := re.fullmatch(r"sequence<(.+?)(?:,\s*\d+)?>", kind):
        kind, length = sequence[1], 0
    # What rosapi makes of a sequence with a bound.
    kind = kind.partition(",")[0]
    if array := re.fullmatch(r"(.+)\[(?:<=)?(\d{0,9})\]", kind):
        is_bound = "<=" in kind
        kind, length = array[1], 0 if is_bound or not array[2] else int(array[2])
    if length is not None and length > MAX_ARRAY:
        raise UnknownTypeError("an array that is too long")
    kind = short_name(re.sub(r"^string<(=?)\d+>$", "string", kind))
    if kind not in PRIMITIVES and not TYPE_NAME.fullmatch(kind):
        raise UnknownTypeError(kind[:200])
    return RosField(name, kind, length)


def _objects(values: object, most: int) -> Iterable[Mapping[str, Any]]:
    if not isinstance(values, list) or len(values) > most:
        raise UnknownTypeError("no list of types")
    return [value for value in values if isinstance(value, dict)]


def _check(name: str, types: RosTypes, outer: tuple[str, ...], checked_names: set[str]) -> None:
    """Add what a type consists of to the names, each type once: there may be 2 ** 100 ways to the same one."""
    if name in checked_names:
        return
    if name in outer or name not in types or len(outer) > MAX_TYPES:
        raise UnknownTypeError(name[:200])
    for kind in dict.fromkeys(field.type for field in types[name]):
        _check(kind, types, (*outer, name), checked_names)
    checked_names.add(name)


def _inner(name: str, types: RosTypes) -> list[str]:
    """Return the types in a type, each once."""
    names: dict[str, None] = {}
    waiting = [name]
    while waiting:
        for field in types[waiting.pop()]:
            if field.type not in PRIMITIVES and field.type not in names:
                names[field.type] = None
                waiting.append(field.type)
    return list(names)


def _lines(fields: tuple[RosField, ...]) -> str:
    return "".join(f"{field.type}{_brackets(field.length)} {field.name}\n" for field in fields)


def _brackets(length: int | None) -> str:
    if length is None:
        return ""
    return "[]" if length == 0 else f"[{length}]"
