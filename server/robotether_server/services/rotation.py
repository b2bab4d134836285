"""Lets an active robot change its key, by a signature of the key that it has.

Used by joining.py, which holds the enrolment lock. Must never change a key that did not sign.
"""

from dataclasses import dataclass

from robotether_server import signatures
from robotether_server.db import Transaction, audit, claims, robots
from robotether_server.db.audit import Event, Source
from robotether_server.db.robots import Robot
from robotether_server.problems import FieldInvalid
from robotether_server.services import enrolment, enrolment_credentials
from robotether_server.services.enrolment import PresentedKey

NAMESPACE = "robotether-rotation"


@dataclass(frozen=True)
class PreviousKey:
    """The key that a robot had until now, and its signature over MAC and new key."""

    fingerprint: str
    signature: str


def rotate(tx: Transaction, robot: Robot, presented: PresentedKey, previous: PreviousKey) -> bool:
    """Put the new key in place of the one that signed it; False: the robot is not active with that one.

    Raises FieldInvalid for a signature that does not hold, and KeyInUse.
    """
    old = robot.key
    if old is None or robot.state != "active" or previous.fingerprint != old.fingerprint:
        return False
    if not signatures.holds(old, NAMESPACE, message(presented), previous.signature):
        raise FieldInvalid(
            f"cannot use previous_key: its signature is not one of key {old.fingerprint} over this MAC and the "
            "new key"
        )
    source = Source(enrolment_credentials.ROBOT, presented.report.address)
    enrolment.check_key_is_free(tx, source, presented, is_authorized=True)
    claim = claims.find(tx, presented.key.fingerprint)
    if claim is not None:
        claims.remove(tx, claim.id)
    robots.rotate_key(tx, robot.id, presented.key)
    details: dict[str, object] = {"was": old.fingerprint, "fingerprint": presented.key.fingerprint}
    audit.record(tx, source, Event("key_rotated", robot.name, details))
    return True


def message(presented: PresentedKey) -> str:
    """Return what the old key signs."""
    return f"{presented.mac} {presented.key.line}\n"
