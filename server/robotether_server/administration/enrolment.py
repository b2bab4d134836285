"""How a key becomes a robot's own: what joins and playbooks share. Its callers hold the enrolment lock.

A MAC only names a robot, and showing a public key proves nothing. So without somebody who vouches a key only
waits, and nothing that waits may keep a robot out that somebody vouches for. An active robot's key is never
replaced here.
"""

from dataclasses import dataclass

from robotether_server import macs, ssh_keys
from robotether_server.administration.vouching import Vouch
from robotether_server.problems import (
    KeyInUse,
    KeyRejected,
    MacInUse,
    RecordExists,
    RobotDisabled,
    TokenUsedUp,
)
from robotether_server.ssh_keys import PublicKey
from robotether_server.store import Transaction, audit, claims, join_tokens, robots
from robotether_server.store.audit import Event, Source
from robotether_server.store.robots import Report, Robot


@dataclass(frozen=True)
class Registration:
    """What PUT /api/v1/robots/NAME says. `vouch` is who may, from vouching.py."""

    name: str
    mac: str
    public_key: str
    vouch: Vouch
    hostname: str = ""
    agent_version: str = ""
    allow_local_mac: bool = False


def register(tx: Transaction, source: Source, registration: Registration) -> tuple[Robot, bool]:
    """Make the robot active with this key, or find it so; see robots.register."""
    raise NotImplementedError
