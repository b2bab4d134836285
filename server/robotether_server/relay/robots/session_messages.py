"""Parses and builds the lines between agent and relay.

Pure. The contract is the section "The session" of docs/reference/protocols.md.
"""

from __future__ import annotations

import hmac
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_args

from robotether_common.guard import REFUSED_KINDS
from robotether_common.session import Battery, ByeCode, GuardState, Kind, ServiceState

from robotether_server.db.control import MAX_NAME
from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.robots.sessions import GuardMode, GuardReport

MAX_ID = 64
# Some 30 years; a machine's CLOCK_BOOTTIME begins when it starts.
MAX_UPTIME_MS = 1e12
# What a browser, too, reads as the number that it is.
MAX_COUNT = 2**53 - 1
FULL_PERCENT = 100


class BrokenLineError(ValueError):
    """A line that breaks the contract; the text names the field."""


class WrongKeyError(Exception):
    """The preface has not this stack's session key."""


@dataclass(frozen=True)
class Preface:
    """Who connects, as the session command on sshd says."""

    kind: Kind
    robot_id: int
    address: str
    # Which key logged in (SHA256:...), and on what this login may listen.
    fingerprint: str
    ports: frozenset[int]


def parse_line(line: bytes) -> dict[str, Any]:
    """Read one line as a JSON object with a `type`."""
    try:
        message = json.loads(line.decode())
    except (ValueError, RecursionError) as exc:
        raise BrokenLineError("cannot read a line: it is not JSON in UTF-8") from exc
    if not isinstance(message, dict) or not isinstance(message.get("type"), str):
        raise BrokenLineError("cannot read a line: it is no object with a type")
    return message


def parse_preface(line: bytes, session_key: str) -> Preface:
    """Read the first line of a connection; WrongKeyError before anything else is believed."""
    message = parse_line(line)
    given = message.get("session_key")
    if not isinstance(given, str) or not hmac.compare_digest(given.encode(), session_key.encode()):
        raise WrongKeyError
    if message["type"] != "preface":
        raise BrokenLineError("cannot read the first line: its type is not preface")
    return Preface(
        kind=kind_field(message, "kind"),
        robot_id=whole_field(message, "robot_id"),
        address=text_field(message, "address", 45),
        fingerprint=text_field(message, "fingerprint", 64),
        ports=ports_field(message, "ports"),
    )


def text_field(message: Mapping[str, Any], name: str, max_length: int) -> str:
    """Read a text field of bounded length."""
    value = message.get(name)
    if not isinstance(value, str) or len(value) > max_length:
        raise BrokenLineError(f"cannot read field {name}: no text of up to {max_length} characters")
    return value


def printable_field(message: Mapping[str, Any], name: str, max_length: int) -> str:
    """Read a text that people see and the database keeps, which cannot take every text that JSON can spell."""
    value = text_field(message, name, max_length)
    if not value.isprintable():
        raise BrokenLineError(f"cannot read field {name}: it holds what is not printable")
    return value


def whole_field(message: Mapping[str, Any], name: str) -> int:
    """Read a whole number."""
    value = message.get(name)
    if not isinstance(value, int) or isinstance(value, bool):
        raise BrokenLineError(f"cannot read field {name}: no whole number")
    return value


def count_field(message: Mapping[str, Any], name: str) -> int:
    """Read how often something happened."""
    value = whole_field(message, name)
    if not 0 <= value <= MAX_COUNT:
        raise BrokenLineError(f"cannot read field {name}: it is no count")
    return value


def ports_field(message: Mapping[str, Any], name: str) -> frozenset[int]:
    """Read a list of ports."""
    value = message.get(name)
    if not isinstance(value, list) or not all(type(port) is int for port in value):
        raise BrokenLineError(f"cannot read field {name}: no list of whole numbers")
    return frozenset(value)


def kind_field(message: Mapping[str, Any], name: str) -> Kind:
    """Read `session`, `media` or `shell`."""
    value = message.get(name)
    for allowed in get_args(Kind):
        if value == allowed:
            kind: Kind = allowed
            return kind
    raise BrokenLineError(f"cannot read field {name}: it is not session, media or shell")


def health_field(message: Mapping[str, Any], name: str) -> ServiceState:
    """Read `ok`, `down` or `unknown`."""
    value = message.get(name)
    for allowed in get_args(ServiceState):
        if value == allowed:
            health: ServiceState = allowed
            return health
    raise BrokenLineError(f"cannot read field {name}: it is not ok, down or unknown")


def guard_mode_field(message: Mapping[str, Any], name: str) -> GuardMode:
    """Read `on` or `off`."""
    value = message.get(name)
    if value == "on":
        return "on"
    if value == "off":
        return "off"
    raise BrokenLineError(f"cannot read field {name}: it is not on or off")


def clock_field(message: Mapping[str, Any], name: str) -> float:
    """Read the agent's clock in ms."""
    value = message.get(name)
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise BrokenLineError(f"cannot read field {name}: no number of milliseconds")
    # Not a number is in no range.
    if not 0 <= value <= MAX_UPTIME_MS:
        raise BrokenLineError(f"cannot read field {name}: no number of milliseconds")
    return float(value)


def bool_field(message: Mapping[str, Any], name: str) -> bool:
    """Read a truth value."""
    value = message.get(name)
    if not isinstance(value, bool):
        raise BrokenLineError(f"cannot read field {name}: it is not true or false")
    return value


def parse_guard(message: Mapping[str, Any]) -> tuple[GuardReport, str | None]:
    """Read what a guard tells of itself, and the id of what it answers."""
    answers = message.get("answers")
    report = GuardReport(
        state=_guard_state(message),
        stopped=bool_field(message, "stopped"),
        by=printable_field(message, "by", MAX_NAME),
        moving=bool_field(message, "moving"),
        refused=_refused_field(message),
    )
    return report, None if answers is None else text_field(message, "answers", MAX_ID)


def parse_vitals(message: Mapping[str, Any]) -> Battery | None:
    """Read how full a robot's battery is; None: it has none, or nothing is heard of it."""
    value = message.get("battery")
    if value is None:
        return None
    if not isinstance(value, dict):
        raise BrokenLineError("cannot read field battery: no object")
    percent = value.get("percent")
    if not isinstance(percent, int | float) or isinstance(percent, bool):
        raise BrokenLineError("cannot read field percent: no number")
    # Not a number is in no range.
    if not 0 <= percent <= FULL_PERCENT:
        raise BrokenLineError("cannot read field percent: no number from 0 to 100")
    return Battery(round(percent), bool_field(value, "charging"))


def _guard_state(message: Mapping[str, Any]) -> GuardState:
    value = message.get("state")
    for allowed in get_args(GuardState):
        if value == allowed:
            state: GuardState = allowed
            return state
    raise BrokenLineError("cannot read field state: it is not ready or down")


def _refused_field(message: Mapping[str, Any]) -> tuple[tuple[str, int], ...]:
    value = message.get("refused", {})
    if not isinstance(value, dict):
        raise BrokenLineError("cannot read field refused: no object")
    # Kinds of a newer guard are not shown; a robot must not be able to name as many as it likes.
    return tuple((kind, count_field(value, kind)) for kind in REFUSED_KINDS if kind in value)


def config_line(
    robot: RelayRobot, *, heartbeat_s: float, timeout_s: float, guard_key: str, direct: bool
) -> bytes:
    """Build the settings that the agent works with."""
    return _line(
        "config",
        robot=robot.name,
        ros_port=robot.ros_port,
        video_port=robot.video_port,
        shell_port=robot.shell_port,
        rotate_key=robot.rotate_key,
        heartbeat_s=heartbeat_s,
        timeout_s=timeout_s,
        guard={"key": guard_key, **robot.settings.guard.as_dict()},
        direct=direct,
    )


def lease_line(fence: int, *, held: bool) -> bytes:
    """Tell the newest number, and whether somebody drives with it."""
    return _line("lease", fence=fence, held=held)


def stop_line(message_id: str, by: str) -> bytes:
    """Build the order to stop."""
    return _line("stop", id=message_id, by=by)


def release_line(message_id: str, by: str) -> bytes:
    """Build the order to be stopped no more."""
    return _line("release", id=message_id, by=by)


def checked_line(*, ros: ServiceState, video: ServiceState, shell: ServiceState) -> bytes:
    """Build the answer to `check`."""
    return _line("checked", ros=ros, video=video, shell=shell)


def ping_line(seq: int) -> bytes:
    """Build a heartbeat."""
    return _line("ping", seq=seq)


def pong_line(ping: Mapping[str, Any]) -> bytes:
    """Build the answer to the agent's heartbeat, which carries its own clock back."""
    return _line("pong", seq=whole_field(ping, "seq"), t_ms=clock_field(ping, "t_ms"))


def bye_line(code: ByeCode, detail: str) -> bytes:
    """Build the last line of a connection."""
    return _line("bye", code=code, detail=detail)


def _line(kind: str, **fields: object) -> bytes:
    return json.dumps({"type": kind, **fields}).encode() + b"\n"
