"""The buttons of a robot's drive page: each publishes one message or calls one service.

Part of a robot's settings (robot_settings.py), as `buttons`; docs/protocols.md describes them. A button gives
nobody a right: robot_settings refuses one that the robot's policy does not let a driver send. Pure.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from typing import Any, Literal

from robotether_server import setting_values
from robotether_server.problems import FieldInvalid

Kind = Literal["publish", "call"]

MAX_BUTTONS = 24
MAX_NAME_LENGTH = 40
# Of the JSON text of what a button sends, in bytes.
MAX_FIELDS_BYTES = 2048
MAX_FIELDS_DEPTH = 16
WHOLE_64_BIT = (-(2**63), 2**64 - 1)
# In either ROS's spelling: std_msgs/Bool, std_msgs/msg/Bool.
ROS_TYPE = re.compile(
    r"[A-Za-z][A-Za-z0-9_]{0,63}(?:/(?:msg|srv))?/[A-Za-z][A-Za-z0-9_]{0,63}", re.ASCII
)
# By kind: which member has the name of what is sent to, and which what is sent.
MEMBERS: dict[Kind, tuple[str, str]] = {"publish": ("topic", "msg"), "call": ("service", "args")}


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


def parse(given: object) -> tuple[Button, ...]:
    """Return the buttons of a JSON list; raise FieldInvalid, which names the member: buttons.1 is the first."""
    each = setting_values.listed(given, "buttons", MAX_BUTTONS, "buttons")
    buttons = tuple(parse_one(one, f"buttons.{place}") for place, one in enumerate(each, 1))
    names = [button.name for button in buttons]
    for name in names:
        if names.count(name) > 1:
            raise FieldInvalid(f"cannot use buttons: there are two of the name {name!r}")
    return buttons


def parse_one(given: object, path: str = "button") -> Button:
    """Return one button; raise FieldInvalid."""
    kind = setting_values.choice(_member(given, path, "kind"), f"{path}.kind", tuple(MEMBERS))
    target, sent = MEMBERS[kind]
    present = setting_values.members(given, path, ("name", "kind", target, "type", sent, "confirm"))
    return Button(
        name=setting_values.label(present.get("name"), f"{path}.name", MAX_NAME_LENGTH),
        kind=kind,
        target=setting_values.ros_name(present.get(target), f"{path}.{target}"),
        type=_type(present.get("type", ""), f"{path}.type", may_be_empty=kind == "call"),
        fields=_fields(present.get(sent, {}), f"{path}.{sent}"),
        confirm=setting_values.flag(present.get("confirm", False), f"{path}.confirm"),
    )


def _member(given: object, path: str, name: str) -> object:
    if not isinstance(given, dict):
        raise FieldInvalid(f"cannot use {path}: it must be an object with members")
    return given.get(name)


def _type(given: object, path: str, *, may_be_empty: bool) -> str:
    if given == "" and may_be_empty:
        return ""
    if not isinstance(given, str) or not ROS_TYPE.fullmatch(given):
        raise FieldInvalid(f"cannot use {path}: it must be a type of ROS, such as std_msgs/Bool")
    return given


def _fields(given: object, path: str) -> str:
    if not isinstance(given, dict):
        raise FieldInvalid(f"cannot use {path}: it must be a JSON object, such as {{}}")
    _check(given, path, 1)
    # One text for each meaning, so that buttons can be compared: to Python, true is 1.
    text = json.dumps(given, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    try:
        size = len(text.encode())
    except UnicodeEncodeError:
        raise FieldInvalid(f"cannot use {path}: it holds half of a character") from None
    if size > MAX_FIELDS_BYTES:
        raise FieldInvalid(f"cannot use {path}: it has over {MAX_FIELDS_BYTES} bytes as JSON")
    return text


def _check(value: Any, path: str, depth: int) -> None:
    """Refuse what the relay would not pass on (relay/rosbridge/json_text.py), or no robot reads."""
    if depth > MAX_FIELDS_DEPTH:
        raise FieldInvalid(f"cannot use {path}: it is nested more than {MAX_FIELDS_DEPTH} deep")
    if isinstance(value, dict):
        for inner in value.values():
            _check(inner, path, depth + 1)
    elif isinstance(value, list):
        for inner in value:
            _check(inner, path, depth + 1)
    elif isinstance(value, float) and not math.isfinite(value):
        raise FieldInvalid(f"cannot use {path}: NaN and infinity are no numbers of JSON")
    elif isinstance(value, int) and not WHOLE_64_BIT[0] <= value <= WHOLE_64_BIT[1]:
        raise FieldInvalid(f"cannot use {path}: a number in it has more than 64 bits")
