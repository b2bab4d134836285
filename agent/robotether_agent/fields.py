"""Typed getters for every field that comes from outside (join answers, session lines, own JSON files).

Each names the field in its error, so that a wrong answer can be understood from one log line.
Never hands on a value that was not checked. `line_of` writes the lines that the other side reads so. What settings hold
too is spelt here: hosts, robots' names, and MAC addresses.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import cast

from robotether_agent.problems import DetailError

JsonObject = Mapping[str, object]

HOST = re.compile(r"(?!-)[A-Za-z0-9._-]{1,253}")
IPV6 = re.compile(r"[0-9A-Fa-f:.]{2,45}")
ADDRESS = re.compile(f"(?:{HOST.pattern})|(?:{IPV6.pattern})")
MAC = re.compile(r"[0-9a-f]{2}(:[0-9a-f]{2}){5}")
SEPARATORS = re.compile(r"[:.\-\s]")
HEX12 = re.compile(r"[0-9a-f]{12}")
# As some systems print it, without leading zeros.
SIX_PARTS = re.compile(r"[0-9a-f]{1,2}(?:([:-])[0-9a-f]{1,2})(?:\1[0-9a-f]{1,2}){4}")
TOPIC = re.compile(r"(/[A-Za-z0-9_]+)+")
ROBOT_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,62}")
# Maximum number of cells used of a list: each that does not answer costs some seconds.
MAX_CELLS = 8
MAX_PORTS = 8
MAX_RANK = 1000


class FieldError(DetailError, ValueError):
    """A field is missing or has the wrong type or range; callers translate it."""


@dataclass(frozen=True)
class ListedCell:
    """One machine of the server: the host and the ports at which its SSH is.

    Of two with one `rank` the robot chooses; else the lower one comes first, however far it is.
    """

    host: str
    ports: tuple[int, ...]
    rank: int = field(default=0, compare=False)


def parse_object(data: bytes | str, what: str) -> JsonObject:
    """Return the JSON object in `data`; `what` names it in errors."""
    try:
        value = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise FieldError(f"{what} is not JSON") from error
    return as_object(value, what)


def line_of(message: JsonObject) -> bytes:
    """Return a message as one line of JSON in UTF-8, for the session and the guard's pipes."""
    return json.dumps(message, separators=(",", ":")).encode() + b"\n"


def as_object(value: object, what: str) -> JsonObject:
    """Return `value` if it is a JSON object; `what` names it in errors."""
    if not isinstance(value, dict):
        raise FieldError(f"{what} must be a JSON object, not {_excerpt(value)}")
    return cast("JsonObject", value)


def get_object(obj: JsonObject, name: str) -> JsonObject:
    """Return the JSON object at `name`."""
    return as_object(_present(obj, name), name)


def get_text(obj: JsonObject, name: str, *, default: str | None = None, limit: int = 500) -> str:
    """Return the text at `name` for people: shortened, and without control characters for the log."""
    if name not in obj and default is not None:
        return default
    return printable(_str(_present(obj, name), name), limit)


def get_match(obj: JsonObject, name: str, pattern: re.Pattern[str], allowed: str) -> str:
    """Return the text at `name`, which must match `pattern` as a whole; `allowed` says how."""
    text = _str(_present(obj, name), name)
    if not pattern.fullmatch(text):
        raise FieldError(f"field {name} must be {allowed}, not {printable(text, 80)!r}")
    return text


def get_int(obj: JsonObject, name: str, low: int, high: int) -> int:
    """Return the whole number at `name`, from `low` to `high`."""
    return _int(_present(obj, name), name, low, high)


def get_optional_port(obj: JsonObject, name: str) -> int | None:
    """Return the TCP port at `name`, or None when it is null or missing."""
    return None if obj.get(name) is None else _int(obj[name], name, 1, 65535)


def get_flag(obj: JsonObject, name: str, *, default: bool) -> bool:
    """Return the truth value at `name`."""
    value = obj.get(name, default)
    if not isinstance(value, bool):
        raise FieldError(f"field {name} must be true or false, not {_excerpt(value)}")
    return value


def get_number(obj: JsonObject, name: str, low: float, high: float) -> float:
    """Return the finite number at `name`, from `low` to `high`."""
    value = _present(obj, name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise FieldError(f"field {name} must be a number, not {_excerpt(value)}")
    # Not true of NaN either. A whole number may be larger than any float, which only a comparison bears.
    if not low <= value <= high:
        raise FieldError(f"field {name} must be from {low:g} to {high:g}, not {_excerpt(value)}")
    return float(value)


def number_in(message: JsonObject, name: str) -> float | None:
    """Return the number at `name` of a ROS message; None: it is missing, no number, or not finite."""
    value = message.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    # A whole number may be larger than any float, and must not end what reads the message.
    with suppress(OverflowError):
        return float(value) if math.isfinite(value) else None
    return None


def get_optional_number(obj: JsonObject, name: str, low: float, high: float) -> float | None:
    """Return the finite number at `name`, or None when it is null or missing."""
    return None if obj.get(name) is None else get_number(obj, name, low, high)


def get_texts(obj: JsonObject, name: str, *, limit: int = 8) -> list[str]:
    """Return the list of texts at `name`: at least one, at most `limit`."""
    return [_str(value, f"{name}[{at}]") for at, value in enumerate(_list(obj, name, limit))]


def get_ports(obj: JsonObject, name: str) -> tuple[int, ...]:
    """Return the list of TCP ports at `name`: at least one, at most MAX_PORTS."""
    values = _list(obj, name, MAX_PORTS)
    return tuple(_int(value, f"{name}[{at}]", 1, 65535) for at, value in enumerate(values))


def get_cells(obj: JsonObject, name: str) -> tuple[ListedCell, ...]:
    """Return the first MAX_CELLS of the list of cells at `name`; none when it is null, missing or empty."""
    values = obj.get(name)
    if values is None:
        return ()
    if not isinstance(values, list):
        raise FieldError(f"field {name} must be a list of cells, not {_excerpt(values)}")
    return tuple(_cell(as_object(value, f"{name}[{at}]"), at) for at, value in enumerate(values))[
        :MAX_CELLS
    ]


def _cell(obj: JsonObject, place: int) -> ListedCell:
    # They become arguments of the SSH client, so they must not look like options.
    host = get_match(obj, "host", ADDRESS, "a host name")
    # A list without ranks, of a join or an older server, is followed as it is.
    rank = get_int(obj, "rank", 0, MAX_RANK) if "rank" in obj else place
    return ListedCell(host, get_ports(obj, "ports"), rank)


def printable(text: str, limit: int = 500) -> str:
    """Return `text` safe for a log line: one line, no control characters, at most `limit` long."""
    clean = "".join(char if char.isprintable() else " " for char in text[: limit + 1]).strip()
    return clean if len(text) <= limit else clean[: limit - 3] + "..."


class MacError(DetailError, ValueError):
    """The text is not a MAC address that can name a robot; the message says why."""


def normalise_mac(text: str, *, allow_local: bool = False) -> str:
    """Return `text`, a MAC in any usual spelling, as aa:bb:cc:dd:ee:ff; raise MacError."""
    spelling = text.strip().lower()
    if SIX_PARTS.fullmatch(spelling):
        spelling = ":".join(part.zfill(2) for part in SEPARATORS.split(spelling))
    digits = SEPARATORS.sub("", spelling)
    if not HEX12.fullmatch(digits):
        raise MacError(f"{text!r} is not a MAC address such as 00:1b:44:11:3a:b7")
    if digits == "0" * 12:
        raise MacError(f"{text} is the zero address")
    first = int(digits[:2], 16)
    if first & 0x01:
        raise MacError(f"{text} is a multicast or broadcast address")
    if first & 0x02 and not allow_local:
        raise MacError(f"{text} is locally administered, so another robot may have it too")
    return ":".join(digits[at : at + 2] for at in range(0, 12, 2))


def _present(obj: JsonObject, name: str) -> object:
    if name not in obj:
        raise FieldError(f"field {name} is missing")
    return obj[name]


def _list(obj: JsonObject, name: str, limit: int) -> list[object]:
    value = _present(obj, name)
    if not isinstance(value, list) or not 1 <= len(value) <= limit:
        raise FieldError(f"field {name} must be a list of 1 to {limit}, not {_excerpt(value)}")
    return value


def _str(value: object, name: str) -> str:
    if not isinstance(value, str):
        raise FieldError(f"field {name} must be text, not {_excerpt(value)}")
    return value


def _int(value: object, name: str, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise FieldError(
            f"field {name} must be a whole number from {low} to {high}, not {_excerpt(value)}"
        )
    return value


def _excerpt(value: object) -> str:
    return printable(repr(value), 80)
