"""Parses and builds the lines between agent and relay: what each means, and when it comes.

Pure. The section "The session" of docs/reference/protocols.md says how they are sent.
"""

from __future__ import annotations

import hmac
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar, get_args

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import force_setattr
from robotether_common.audit_head import MAX_POSITION
from robotether_common.guard import MAX_NUMBER, MAX_SLOWED_S, REFUSED_KINDS, STOP_CAUSES
from robotether_common.services import SERVICES
from robotether_common.session import (
    LOWEST_PRIORITY,
    MAX_EPOCH,
    MAX_FENCE,
    MAX_HELP_REASON,
    Battery,
    ByeCode,
    GuardState,
    HelpCall,
    HelpSource,
    Kind,
    ServiceState,
)

from robotether_server.db.cells import SshAddresses
from robotether_server.db.control import MAX_NAME
from robotether_server.db.fleet import RelayRobot
from robotether_server.identity import MAX_SIGNATURE_LENGTH
from robotether_server.problems import ProtocolError, RobotetherError

T = TypeVar("T")

MAX_DETAIL = 300
# Some 30 years at most; a machine's CLOCK_BOOTTIME begins when it starts.
UptimeMs = Annotated[float, Meta(ge=0, le=1e12)]
# Maximum integer that a browser reads exactly.
MAX_COUNT = 2**53 - 1
Count = Annotated[int, Meta(ge=0, le=MAX_COUNT)]

# Maximum number of ages in a report, and age in ms.
MAX_AGES, MAX_AGE_MS = 64, 60_000
AgeMs = Annotated[float, Meta(ge=0, le=MAX_AGE_MS)]

# Maximum of a coordinate in metres: odometry that has gone wrong says more.
MAX_COORDINATE_M = 1e9
Sha256 = Annotated[str, Meta(pattern=r"^[0-9a-f]{64}\Z")]

Epoch = Annotated[int, Meta(ge=0, le=MAX_EPOCH)]


# What the agent does in front of rosbridge; unknown until it has said so.
GuardMode = Literal["on", "off", "unknown"]
# x and y in metres, in the frame of the robot's own pose.
Position = tuple[float, float]


class WrongKeyError(RobotetherError):
    """The preface has not this stack's session key."""


class Preface(Struct, frozen=True, tag="preface"):
    """Who connects, as the session command on sshd says."""

    kind: Kind
    robot_id: int
    address: Annotated[str, Meta(max_length=45)]
    # Which key logged in (SHA256:...), and on what this login may listen.
    fingerprint: Annotated[str, Meta(max_length=64)]
    ports: frozenset[int]
    # From which port of the address; 0: an older session command.
    port: Annotated[int, Meta(ge=0, le=65535)] = 0

    @property
    def connection_id(self) -> str | None:
        """How sshd's log names the connection; None: unknown."""
        return f"{self.address} port {self.port}" if self.port else None


class PingLine(Struct, tag="ping"):
    """The agent's heartbeat, with its CLOCK_BOOTTIME."""

    seq: int
    t_ms: UptimeMs


class PongLine(Struct, tag="pong"):
    """The answer to the relay's heartbeat."""

    seq: int


class HelloLine(Struct, tag="hello"):
    """What the robot is: the first line on `session`.

    `epoch` orders a robot's sessions, at any cell. It is the Unix time of the session's start in ms by the robot's
    clock, and more than that of the session before; 0: an older agent.
    """

    hostname: Annotated[str, Meta(max_length=253)]
    agent_version: Annotated[str, Meta(max_length=32)]
    guard: GuardMode
    epoch: Epoch = 0

    def __post_init__(self) -> None:
        _check_printable("agent_version", self.agent_version)


@dataclass(frozen=True)
class GuardReport:
    """What a robot's guard last reported of itself.

    Since its start `refused` counts drive commands by kind, and `stops` by cause how often it stopped a robot that
    moved. `fence` is the newest number of a lease that it knows. `blind_limits`: it has the limits `blind_m` and
    `blind_deg`, which older guards ignore.
    """

    state: GuardState = "down"
    stopped: bool = False
    by: str = ""
    moving: bool = False
    refused: tuple[tuple[str, int], ...] = ()
    fence: int = 0
    blind_limits: bool = False
    stops: tuple[tuple[str, int], ...] = ()


class GuardLine(Struct, tag="guard"):
    """What a guard reports of itself, and the id of the message that it answers, `stop` or `release`.

    It comes when the guard has read its latch, when a member changes (`refused` and `stops`: at most every second), and
    as the answer. `stopped` is what the disk has. `refused` and `stops` count since the guard's start; an older guard
    does not count its stops. `unheard`, the driven topics without a listener on the robot, is for the agent alone.
    """

    state: GuardState
    stopped: bool
    by: Annotated[str, Meta(max_length=MAX_NAME)]
    moving: bool
    refused: dict[str, Count] = {}
    stops: dict[str, Count] = {}
    fence: Annotated[int, Meta(ge=0, le=MAX_FENCE)] = 0
    blind_limits: bool = False
    answers: Annotated[str, Meta(max_length=64)] | None = None

    def __post_init__(self) -> None:
        _check_printable("by", self.by)

    @property
    def report(self) -> GuardReport:
        """What the registry keeps; a robot cannot name as many kinds as it likes."""
        refused = _counts_of(self.refused, REFUSED_KINDS)
        stops = _counts_of(self.stops, STOP_CAUSES)
        # A robot that lies leaves numbers above its own, which the next guard accepts.
        fence = min(self.fence, MAX_COUNT)
        return GuardReport(
            self.state, self.stopped, self.by, self.moving, refused, fence, self.blind_limits, stops
        )


def _counts_of(counts: Mapping[str, int], names: Iterable[str]) -> tuple[tuple[str, int], ...]:
    """Return the counts that have one of these names."""
    return tuple((name, counts[name]) for name in names if name in counts)


class SeenReport(Struct, frozen=True, tag="seen"):
    """How old was what the driver with this fence saw at its newest commands, in ms, and what followed from it.

    At most every 0.5 s, of the commands that moved the robot since the last report; of over 64 ages only the greatest
    remains. An age of None is unknown. `slowed_s` is the time for which commands were slowed since the last report
    (None: the guard does not say), the others the limits by which the newest one was (None: it was not, or has no such
    limit).
    """

    fence: Annotated[int, Meta(ge=1, le=MAX_FENCE)]
    ages_ms: Annotated[tuple[AgeMs | None, ...], Meta(max_length=MAX_AGES)]
    slowed_s: Annotated[float, Meta(ge=0)] | None = None
    max_speed_m_s: Annotated[float, Meta(ge=0, le=MAX_NUMBER)] | None = None
    max_turn_rad_s: Annotated[float, Meta(ge=0, le=MAX_NUMBER)] | None = None

    def __post_init__(self) -> None:
        if self.slowed_s is not None:
            # A longer time costs its report some accuracy, but no session.
            force_setattr(self, "slowed_s", min(self.slowed_s, MAX_SLOWED_S))


class HealthLine(Struct, tag="health"):
    """Whether the robot's own services answer, and whether its rosbridge is open beyond loopback; when that changes.

    `video` is `ok` if any source of the robot's `video_source` answers.
    """

    ros: ServiceState
    video: ServiceState
    ros_exposed: bool


class BatteryState(Struct):
    """How full a robot's battery is (None: unknown or in doubt), and whether it is being charged."""

    percent: Annotated[float, Meta(ge=0, le=100)] | None
    charging: bool


class VitalsLine(Struct, tag="vitals"):
    """What a robot reports of its battery, at most every 5 s; None: it has none, or it was silent for 60 s."""

    battery: BatteryState | None = None

    @property
    def rounded(self) -> Battery | None:
        """The battery in whole percent."""
        battery = self.battery
        if battery is None:
            return None
        percent = None if battery.percent is None else round(battery.percent)
        return Battery(percent, battery.charging)


HELP_SOURCES = {source: source for source in get_args(HelpSource)}


class HelpLine(Struct, tag="help"):
    """The robot asks for a person. What a newer agent names is read as what is known here, and costs no session.

    The agent sends one of each source in 5 s, and again on the next session unless a later ping was answered.
    """

    source: str
    reason: str
    priority: int = 2

    @property
    def call(self) -> HelpCall:
        """What is asked for, within bounds."""
        reason = self.reason[:MAX_HELP_REASON]
        return HelpCall(
            HELP_SOURCES.get(self.source, "robot"),
            "".join(char if char.isprintable() else " " for char in reason).strip(),
            min(max(self.priority, 1), LOWEST_PRIORITY),
        )


class NearerLine(Struct, tag="nearer"):
    """The robot asks for a move to another cell of its list, which is clearly nearer."""

    host: Annotated[str, Meta(max_length=253)]
    ports: tuple[int, ...]


class PositionLine(Struct, tag="position"):
    """Where the robot is, in metres, by the pose topic of its geofence: each second while somebody uses the robot."""

    x: float
    y: float

    @property
    def position(self) -> Position | None:
        """Where it is; None: nobody knows, as of a place that no robot reaches. That costs no session."""
        is_place = max(abs(self.x), abs(self.y)) <= MAX_COORDINATE_M
        return (self.x, self.y) if is_place else None


class SignedHeadLine(Struct, tag="signed_head"):
    """The robot's signature of a line of its chain in the audit log: one line for each that `sign_head` asks for."""

    position: Annotated[int, Meta(ge=1, le=MAX_POSITION)]
    hash: Sha256
    signature: Annotated[str, Meta(max_length=MAX_SIGNATURE_LENGTH)]
    previous: Sha256 | None = None


class CheckLine(Struct, tag="check"):
    """The agent asks whether its ports are reached."""


class _Head(Struct):
    type: str
    session_key: Any = None


Line = (
    PingLine
    | PongLine
    | HelloLine
    | GuardLine
    | SeenReport
    | HealthLine
    | VitalsLine
    | HelpLine
    | NearerLine
    | PositionLine
    | SignedHeadLine
    | CheckLine
)
_HEAD = msgspec.json.Decoder(_Head)
_PREFACE = msgspec.json.Decoder(Preface)
_LINES: dict[object, msgspec.json.Decoder[Line]] = {
    kind.__struct_config__.tag: msgspec.json.Decoder(kind) for kind in get_args(Line)
}


def parse_line(line: bytes) -> Line | None:
    """Read one line; None: its type is not known here. Raises ProtocolError."""
    kind = _parse_head(line).type
    return _parse(_LINES[kind], line, kind) if kind in _LINES else None


def parse_preface(line: bytes, session_key: str) -> Preface:
    """Read the first line of a connection; WrongKeyError before anything else is believed."""
    head = _parse_head(line)
    key = head.session_key
    if not isinstance(key, str) or not hmac.compare_digest(key.encode(), session_key.encode()):
        raise WrongKeyError(
            "its session key is wrong; sshd and relay must have the same SESSION_KEY"
        )
    if head.type != "preface":
        raise ProtocolError("cannot read the first line: its type is not preface")
    return _parse(_PREFACE, line, "preface")


def _parse_head(line: bytes) -> _Head:
    try:
        return _HEAD.decode(line)
    except msgspec.ValidationError as exc:
        raise ProtocolError("cannot read a line: it is not an object with a type") from exc
    except (ValueError, RecursionError) as exc:
        raise ProtocolError("cannot read a line: it is not JSON in UTF-8") from exc


def _parse(decoder: msgspec.json.Decoder[T], line: bytes, kind: str) -> T:
    try:
        return decoder.decode(line)
    except (ValueError, RecursionError) as exc:
        # It may contain a robot's own words.
        raise ProtocolError(f"cannot read {kind}: {exc}"[:MAX_DETAIL]) from exc


def _check_printable(name: str, value: str) -> None:
    """Raise ValueError for what people see and the database keeps, which cannot take every text."""
    if not value.isprintable():
        raise ValueError(f"{name} holds what is not printable")


def config_of(robot: RelayRobot) -> dict[str, Any]:
    """Return what of a configuration a robot's row decides; a live link is sent another one when it changes."""
    return {
        "robot": robot.name,
        **{service.port_member: robot.ports[service.name] for service in SERVICES},
        "rotate_key": robot.rotate_key,
        "guard": robot.settings.guard.as_dict(),
        "battery": robot.settings.battery,
        "help": robot.settings.help_rules,
    }


def config_line(
    robot: RelayRobot,
    *,
    heartbeat_s: float,
    idle_heartbeat_s: float | None,
    timeout_s: float,
    guard_key: str,
    direct: bool,
    media: bool,
    cells: Iterable[SshAddresses],
    connection_id: str | None,
) -> bytes:
    """Build the settings that the agent works with: the first line, sent again when a member changes.

    A `shell_port` of None: no shell. `rotate_key`: the agent joins with a new key and `previous_key`. `media`: it keeps
    the media connection. `idle_heartbeat_s` is not None while nobody uses the robot. With `direct`, `media` is true and
    `idle_heartbeat_s` None. `cells`, only on `session`, are where it connects next, the best first; none: no change.
    `connection_id` is how the logs of sshd and relay name this connection.
    """
    addresses = [{"host": cell.host, "ports": cell.ports, "rank": cell.rank} for cell in cells]
    config = config_of(robot)
    config["guard"] = {"key": guard_key, **config["guard"]}
    return _line(
        "config",
        **config,
        heartbeat_s=heartbeat_s,
        idle_heartbeat_s=idle_heartbeat_s,
        timeout_s=timeout_s,
        direct=direct,
        media=media,
        **({"connection_id": connection_id} if connection_id else {}),
        **({"cells": addresses} if addresses else {}),
    )


def lease_line(fence: int, *, held: bool) -> bytes:
    """Write the newest number, and whether somebody drives with it: after the first `config`, and at each change."""
    return _line("lease", fence=fence, held=held)


def stop_line(message_id: str, by: str) -> bytes:
    """Build the line that stops the robot: after `lease`, at each stop, and every second until the guard confirms."""
    return _line("stop", id=message_id, by=by)


def release_line(message_id: str, by: str) -> bytes:
    """Build the line that releases the stop."""
    return _line("release", id=message_id, by=by)


def sign_head_line(chain: str, position: int, line_hash: str, newest: str | None) -> bytes:
    """Build the request to sign a line; `newest` is the SHA-256 of the robot's newest statement that the server has.

    The agent answers with all later statements, and stores them until then.
    """
    return _line("sign_head", chain=chain, position=position, hash=line_hash, newest=newest)


def checked_line(health: Mapping[str, ServiceState]) -> bytes:
    """Build the answer to `check`, at most every 5 s; `unknown`: no such forward, or video that nobody watches."""
    return _line("checked", **health)


def ping_line(seq: int) -> bytes:
    """Build a heartbeat."""
    return _line("ping", seq=seq)


def pong_line(ping: PingLine) -> bytes:
    """Build the answer to the agent's heartbeat, which carries its own clock back."""
    return _line("pong", seq=ping.seq, t_ms=ping.t_ms)


def bye_line(code: ByeCode, detail: str) -> bytes:
    """Build the last line of a connection; the session command sends `relay_lost` if there was none."""
    return _line("bye", code=code, detail=detail)


def _line(kind: str, **fields: object) -> bytes:
    return json.dumps({"type": kind, **fields}).encode() + b"\n"
