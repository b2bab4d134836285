"""Parses and builds the lines between the relays of two cells.

Pure. Their order is in docs/reference/protocols.md, "Between cells". A cell of another version reads them, too.
"""

from __future__ import annotations

from datetime import datetime
from typing import get_args

import msgspec
from msgspec import Struct

from robotether_server.contract.robots import LiveState
from robotether_server.db.control import Stop, StopId
from robotether_server.problems import ProtocolError


class PeerHello(Struct, frozen=True, tag="hello"):
    """Which cell answers."""

    cell: str


class PeerRobot(Struct, frozen=True, tag="robot"):
    """A robot that has its session at the cell, or had it (`online` false).

    `object` is the part of its robot object that no row has.
    """

    robot_id: int
    epoch: int
    online: bool
    object: LiveState


class PeerStop(Struct, frozen=True, tag="stop"):
    """A stop that is in force."""

    robot_id: int
    at: datetime
    by: str
    reason: str | None = None

    @property
    def stop(self) -> Stop:
        """The stop as the relay keeps it."""
        return Stop(self.robot_id, self.at, self.by, self.reason)


class PeerStopEnd(Struct, frozen=True, tag="released"):
    """A stop that a release has ended."""

    robot_id: int
    at: datetime
    by: str

    @property
    def stop_id(self) -> StopId:
        """Which of the robot's stops."""
        return self.at, self.by


class PeerApp(Struct, frozen=True):
    """A user's web app that is connected to the cell, from an address, if this is known."""

    user_id: int
    name: str
    address: str | None = None


class PeerApps(Struct, frozen=True, tag="apps"):
    """All apps that are connected to the cell now."""

    apps: list[PeerApp]


PeerMessage = PeerHello | PeerRobot | PeerStop | PeerStopEnd | PeerApps
_ENCODER = msgspec.json.Encoder()
_DECODER: msgspec.json.Decoder[PeerMessage] = msgspec.json.Decoder(PeerMessage)
_TAGS = frozenset(kind.__struct_config__.tag for kind in get_args(PeerMessage))


class _PeerHead(Struct):
    type: str


_HEAD = msgspec.json.Decoder(_PeerHead)


def parse(text: str) -> PeerMessage | None:
    """Read a message; None: its type is not known here. Raises ProtocolError."""
    try:
        return _DECODER.decode(text)
    except (ValueError, RecursionError) as exc:
        if _is_unknown(text):
            return None
        raise ProtocolError(f"cannot read a message: {exc}") from exc


def build(message: PeerMessage) -> str:
    """Write a message."""
    return _ENCODER.encode(message).decode()


def _is_unknown(text: str) -> bool:
    try:
        return _HEAD.decode(text).type not in _TAGS
    except (ValueError, RecursionError):
        return False
