"""Finds the messages on drive topics among all that operators send.

Called by the client proxy for every message of every connection. What it lets pass goes to rosbridge as the bytes
that came, so it must read them as rosbridge does: what could be read in two ways is refused. rosbridge, when it
cannot parse a message as a whole, runs an operation that it finds inside; so none that the guard cares for may
stand inside another one. Pure; fuzzed by tests/fuzz.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NoReturn, cast

from robotether_common.guard import STAMP
from robotether_common.ros import MAX_GLOB_LENGTH, Globs, full_name

from robotether_agent.fields import printable
from robotether_agent.guard.refused import Refused

PATTERN = re.compile(rf"[A-Za-z0-9_/*]{{1,{MAX_GLOB_LENGTH}}}")
Operation = Literal["publish", "advertise", "unadvertise"]
MessageId = str | int | None

ON_TOPICS = ("publish", "advertise", "unadvertise")
# They hide other operations.
WRAPPERS = ("fragment", "png")
GUARDED = frozenset((*ON_TOPICS, *WRAPPERS))
MAX_ID_LENGTH = 256


class DriveTopics:
    """The robot's drive topics: patterns for their full names."""

    def __init__(self, patterns: Sequence[str]) -> None:
        for pattern in patterns:
            if not PATTERN.fullmatch(pattern):
                raise ValueError(f"{pattern[:80]!r} is no name of a topic, with * for any text")
        self.patterns = tuple(patterns)
        self._globs = Globs(patterns)
        self._last_parts = Globs(pattern.rpartition("/")[2] for pattern in patterns)

    def match(self, full: str) -> bool:
        """Tell whether a full name is a drive topic's."""
        return self._globs.match(full)

    def might_be(self, relative: str) -> bool:
        """Tell whether a name without a first slash could be a drive topic's in some namespace of the robot."""
        return self._last_parts.match(relative.rpartition("/")[2])

    def plain(self) -> list[str]:
        """Return those that are names and no patterns."""
        return [pattern for pattern in self.patterns if "*" not in pattern]


@dataclass(frozen=True)
class DriveMessage:
    """An operation on a drive topic; `fields` are the message's own, not looked at yet."""

    operation: Operation
    topic: str
    fields: Mapping[str, Any]


class Unclear(Refused):
    """A message that cannot be checked; `message_id` is its own, for the answer."""

    def __init__(self, why: str, message_id: MessageId = None) -> None:
        super().__init__("shape", why)
        self.message_id = message_id


def message_id(fields: Mapping[str, Any]) -> MessageId:
    """Return what an answer to this message refers to."""
    value = fields.get("id")
    if isinstance(value, str) and len(value) <= MAX_ID_LENGTH:
        return value
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def drive_message(data: bytes, topics: DriveTopics) -> DriveMessage | None:
    """Return the operation on a drive topic, or None: the message may pass unchanged.

    Unclear when neither can be said.
    """
    fields = _parse(data)
    operation = fields.get("op")
    if not isinstance(operation, str):
        raise Unclear("its op is no text", message_id(fields))
    if operation in WRAPPERS:
        raise Unclear(f"the guard cannot check {operation}", message_id(fields))
    if operation not in ON_TOPICS:
        return None
    topic = _topic(fields, topics)
    return None if topic is None else DriveMessage(cast("Operation", operation), topic, fields)


def _topic(fields: Mapping[str, Any], topics: DriveTopics) -> str | None:
    name = fields.get("topic")
    full = full_name(name)
    if full is None:
        shown = printable(str(name), 80)
        raise Unclear(f"{shown!r} is no name like /a/b_1", message_id(fields))
    if topics.match(full):
        return full
    if name != full and topics.might_be(full[1:]):
        raise Unclear(f"{name!r} may be a drive topic; write its full name", message_id(fields))
    if STAMP in fields:
        # The relay stamps drive commands only: its settings and these are not the same at this moment.
        raise Unclear(f"{full} is a drive topic for the server, but not here", message_id(fields))
    return None


class _Parser:
    """Parses one message at a time; not for threads."""

    def __init__(self) -> None:
        self._guarded = 0
        self._decoder = json.JSONDecoder(
            object_pairs_hook=self._object, parse_constant=_no_constant
        )

    def parse(self, text: str) -> object:
        self._guarded = 0
        value = self._decoder.decode(text)
        outermost = isinstance(value, dict) and _is_guarded(value)
        if self._guarded > outermost:
            raise Unclear("it has an operation inside another one")
        return value

    def _object(self, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        made = dict(pairs)
        if len(made) != len(pairs):
            raise Unclear("a key appears twice")
        self._guarded += _is_guarded(made)
        return made


def _parse(data: bytes) -> Mapping[str, Any]:
    try:
        value = _parser.parse(data.decode())
    except (ValueError, RecursionError) as error:
        raise Unclear(f"it is not JSON: {printable(str(error), 120)}") from error
    if not isinstance(value, dict):
        raise Unclear("it is no JSON object")
    return value


def _is_guarded(value: Mapping[str, Any]) -> bool:
    operation = value.get("op")
    return isinstance(operation, str) and operation in GUARDED


def _no_constant(text: str) -> NoReturn:
    raise ValueError(f"JSON has no {text}")


_parser = _Parser()
