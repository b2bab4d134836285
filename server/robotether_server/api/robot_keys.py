"""/api/v1/robots/NAME/...: actions on a robot's key and ports; for admins."""

from msgspec import Struct

from robotether_server.api.auth import Caller
from robotether_server.api.objects import ShownRobot, shown_robot
from robotether_server.api.operations import operation
from robotether_server.db import control_states, robots
from robotether_server.field_types import Fingerprint
from robotether_server.services import pending
from robotether_server.services import robots as robot_service
from robotether_server.services.pending import PendingKey, RejectedKey


class KeyChoice(Struct, forbid_unknown_fields=True):
    """The key that is meant; another key that came since is not affected."""

    fingerprint: Fingerprint


class PendingKeyList(Struct):
    """Keys that wait, oldest first."""

    pending: list[PendingKey]


class RejectedKeyList(Struct):
    """Rejected keys, newest first."""

    rejected_keys: list[RejectedKey]


@operation("POST", "/robots/<robot>/approve", "admin", problems=(409,))
def approve_key(caller: Caller, robot: str, body: KeyChoice) -> ShownRobot:
    """Approve a waiting key, and no other."""
    robot_service.approve(caller.tx, caller.source, robot, body.fingerprint)
    return _shown(caller, robot)


@operation("POST", "/robots/<robot>/reject", "admin", problems=(409,))
def reject_key(caller: Caller, robot: str, body: KeyChoice) -> None:
    """Reject a waiting key, and remember it."""
    robot_service.reject(caller.tx, caller.source, robot, body.fingerprint)


@operation("POST", "/robots/<robot>/rekey", "admin", problems=(409,))
def rekey_robot(caller: Caller, robot: str) -> ShownRobot:
    """Forget the key and end the robot's connection; the next key waits for approval."""
    robot_service.rekey(caller.tx, caller.source, robot)
    return _shown(caller, robot)


@operation("POST", "/robots/<robot>/rotate-key", "admin", problems=(409,))
def rotate_key(caller: Caller, robot: str) -> ShownRobot:
    """Ask the robot's agent for a new key; the connection stays."""
    robot_service.rotate_key(caller.tx, caller.source, robot)
    return _shown(caller, robot)


@operation("POST", "/robots/<robot>/move-ports", "admin", problems=(409, 422))
def move_ports(caller: Caller, robot: str) -> ShownRobot:
    """Assign another free pair of ports; the robot reconnects."""
    robot_service.move_ports(caller.tx, caller.source, robot)
    return _shown(caller, robot)


@operation("GET", "/pending", "admin")
def list_pending(caller: Caller) -> PendingKeyList:
    """List keys that wait for approval."""
    return PendingKeyList(pending.waiting(caller.tx))


@operation("GET", "/rejected-keys", "admin")
def list_rejected_keys(caller: Caller) -> RejectedKeyList:
    """List rejected keys."""
    return RejectedKeyList(pending.rejected(caller.tx))


@operation("DELETE", "/rejected-keys/<int:key_id>", "admin")
def forgive_key(caller: Caller, key_id: int) -> None:
    """Forget the rejection: the key may join again."""
    pending.forgive(caller.tx, caller.source, key_id)


def _shown(caller: Caller, robot: str) -> ShownRobot:
    seen = robots.get_seen(caller.tx, robot)
    return shown_robot(seen, control_states.of_robot(caller.tx, seen.robot.id), for_admin=True)
