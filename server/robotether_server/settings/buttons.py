"""The buttons of a robot's drive page: each publishes one message or calls one service.

Part of a robot's settings (`settings.robot`), as `buttons`; docs/reference/robot-settings.md describes them.
A button grants nothing: robot_settings refuses one that the robot's policy does not let a driver send. Pure.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from robotether_server import schemas
from robotether_server.problems import FieldInvalidError
from robotether_server.schemas import RosName, setting

Kind = Literal["publish", "call"]

MAX_BUTTONS = 24
MAX_NAME_LENGTH = 40
# Maximum size of the JSON text that a button sends.
MAX_FIELDS_BYTES = 2048
MAX_FIELDS_DEPTH = 16
WHOLE_64_BIT = (-(2**63), 2**64 - 1)
# In either ROS's spelling: std_msgs/Bool, std_msgs/msg/Bool.
ROS_TYPE = re.compile(
    r"[A-Za-z][A-Za-z0-9_]{0,63}(?:/(?:msg|srv))?/[A-Za-z][A-Za-z0-9_]{0,63}", re.ASCII
)
# By kind: which member has the name of what is sent to, and which what is sent.
MEMBERS: dict[Kind, tuple[str, str]] = {"publish": ("topic", "msg"), "call": ("service", "args")}


def _type(raw: object, path: str) -> str:
    if not isinstance(raw, str) or not ROS_TYPE.fullmatch(raw):
        raise FieldInvalidError(
            f"cannot use {path}: it must be a type of ROS, such as std_msgs/Bool", path
        )
    return raw


def _type_or_nothing(raw: object, path: str) -> str:
    return "" if raw == "" else _type(raw, path)


def _fields(raw: object, path: str) -> dict[str, Any]:
    if not isinstance(raw, dict):
        raise FieldInvalidError(f"cannot use {path}: it must be a JSON object, such as {{}}", path)
    _check(raw, path, 1)
    try:
        size = len(_text(raw).encode())
    except UnicodeEncodeError:
        raise FieldInvalidError(f"cannot use {path}: it holds half of a character", path) from None
    if size > MAX_FIELDS_BYTES:
        raise FieldInvalidError(
            f"cannot use {path}: it has over {MAX_FIELDS_BYTES} bytes as JSON", path
        )
    return raw


def _text(fields: dict[str, Any]) -> str:
    # One text for each meaning, so that buttons can be compared: to Python, true is 1.
    return json.dumps(fields, sort_keys=True, separators=(",", ":"), ensure_ascii=False)


Fields = Annotated[
    dict[str, Any],
    Meta(extra={"read": _fields}),
    setting("Sends", 'The message or the arguments, as a JSON object: {"data": true}. Empty: {}.'),
]
Name = Annotated[
    str,
    Meta(min_length=1, max_length=MAX_NAME_LENGTH),
    setting("Name", "Its label, such as Dock or Lights on."),
]
Target = Annotated[RosName, setting("Topic or service", "A full name, such as /lights or /dock.")]
TYPE = setting("Type", "Such as std_msgs/Bool or std_srvs/Trigger. May be empty for a service.")
Confirm = Annotated[bool, setting("Ask before it sends")]


class PublishButton(Struct, forbid_unknown_fields=True, tag_field="kind", tag="publish"):
    """A button that publishes a message."""

    name: Name
    topic: Target
    type: Annotated[str, Meta(min_length=1, extra={"read": _type}), TYPE]
    msg: Fields = {}
    confirm: Confirm = False


class CallButton(Struct, forbid_unknown_fields=True, tag_field="kind", tag="call"):
    """A button that calls a service."""

    name: Name
    service: Target
    type: Annotated[str, Meta(extra={"read": _type_or_nothing}), TYPE] = ""
    args: Fields = {}
    confirm: Confirm = False


GivenButton = PublishButton | CallButton
GivenButtons = Annotated[list[GivenButton], Meta(max_length=MAX_BUTTONS)]


@dataclass(frozen=True)
class Button:
    """A button. `target` is its topic or service; `fields` is the JSON text of the object that it sends."""

    name: str
    kind: Kind
    target: str
    type: str = ""
    fields: str = "{}"
    confirm: bool = False

    def as_dict(self) -> dict[str, object]:
        """Return the JSON members, all of them."""
        target, sent = MEMBERS[self.kind]
        return {
            "name": self.name,
            "kind": self.kind,
            target: self.target,
            "type": self.type,
            sent: json.loads(self.fields),
            "confirm": self.confirm,
        }


def parse(raw: object) -> tuple[Button, ...]:
    """Return the buttons of a JSON list; raise FieldInvalidError, which names the member: buttons.1 is the first."""
    return made(schemas.value("buttons", raw, GivenButtons))


def parse_one(raw: object) -> Button:
    """Return one button; raise FieldInvalidError."""
    return _made(schemas.value("button", raw, GivenButton))


def made(rows: list[GivenButton]) -> tuple[Button, ...]:
    """Return the buttons; raise FieldInvalidError for two of one name."""
    buttons = tuple(_made(button) for button in rows)
    names = [button.name for button in buttons]
    for name in names:
        if names.count(name) > 1:
            raise FieldInvalidError(
                f"cannot use buttons: there are two of the name {name!r}", "button.name"
            )
    return buttons


def _made(button: GivenButton) -> Button:
    if isinstance(button, PublishButton):
        fields = _text(button.msg)
        return Button(button.name, "publish", button.topic, button.type, fields, button.confirm)
    fields = _text(button.args)
    return Button(button.name, "call", button.service, button.type, fields, button.confirm)


def _check(value: Any, path: str, depth: int) -> None:
    """Refuse what the relay would not pass on (relay/channels/rosbridge/operations.py), or no robot reads."""
    if depth > MAX_FIELDS_DEPTH:
        raise FieldInvalidError(
            f"cannot use {path}: it is nested more than {MAX_FIELDS_DEPTH} deep", path
        )
    if isinstance(value, dict):
        for inner in value.values():
            _check(inner, path, depth + 1)
    elif isinstance(value, list):
        for inner in value:
            _check(inner, path, depth + 1)
    elif isinstance(value, float) and not math.isfinite(value):
        raise FieldInvalidError(f"cannot use {path}: JSON has no NaN and no infinity", path)
    elif isinstance(value, int) and not WHOLE_64_BIT[0] <= value <= WHOLE_64_BIT[1]:
        raise FieldInvalidError(f"cannot use {path}: a number in it has more than 64 bits", path)
