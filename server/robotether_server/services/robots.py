"""Robots' rows: added, registered, approved, disabled, moved and removed by admins.

Every action takes the enrolment lock first: joins and other actions wait for the end of its transaction.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from robotether_server import identity
from robotether_server.db import Transaction, audit, robots
from robotether_server.db.audit import Source
from robotether_server.db.robots import Claim, Report, RobotRow, State
from robotether_server.problems import (
    MacInUseError,
    NotPossibleError,
    RecordExistsError,
    RobotDisabledError,
)
from robotether_server.services import joining
from robotether_server.services.joining import EnrolmentCredential
from robotether_server.settings import robot as robot_settings
from robotether_server.settings.robot import RobotSettings, Settings


@dataclass(frozen=True)
class Registration:
    """What PUT /api/v1/robots/NAME says. `credential` is the permitted caller's."""

    name: str
    mac: str
    public_key: str
    credential: EnrolmentCredential
    signature: str | None = None
    hostname: str | None = None
    agent_version: str | None = None
    allow_local_mac: bool = False


def add(
    tx: Transaction, source: Source, mac: str, name: str, *, allow_local_mac: bool = False
) -> RobotRow:
    """Announce a robot before it joins; raise FieldInvalidError, RecordExistsError or RecordRefusedError.

    An unknown robot that waits with this MAC does not matter: its row gets the name, and its key waits on.
    """
    robots.lock_enrolment(tx)
    normal = identity.normalise_mac(mac, allow_local=allow_local_mac)
    robot = robots.find_by_mac(tx, normal)
    if robot is not None and robot.is_unknown:
        robots.rename(tx, robot.id, name)
        robots.announce(tx, robot.id)
    else:
        robots.add(tx, normal, name)
    audit.record(tx, source, "robot_added", name, mac=normal)
    return robots.get(tx, name)


def register(tx: Transaction, source: Source, registration: Registration) -> tuple[RobotRow, bool]:
    """Make a robot active with this key; return whether its row was made for it. Asking again changes nothing.

    Raises FieldInvalidError, KeyUnprovenError, RecordExistsError, MacInUseError, KeyInUseError, KeyRejectedError,
    RobotDisabledError or TokenUsedUpError.
    """
    presented = joining.PresentedKey(
        mac=identity.normalise_mac(registration.mac),
        key=identity.parse_robots_key(registration.public_key),
        report=Report(
            registration.hostname or "", registration.agent_version or "", source.address or ""
        ),
    )
    if registration.credential.token is not None:
        is_proven = joining.is_proven(presented, registration.signature)
        joining.check_proven(presented, is_proven=is_proven)
    robots.lock_enrolment(tx)
    joining.check_not_rejected(tx, presented.key)
    robot = robots.find_by_mac(tx, presented.mac)
    if robot is not None:
        _check_may_register(robot, presented)
        is_in = robot.state == "active" and robot.fingerprint == presented.key.fingerprint
        if is_in and registration.credential.token is not None:
            # A playbook with a join token cannot ask for the name that an admin has given the robot since.
            return robot, False
        robot = _named(tx, source, robot, registration.name)
        if is_in:
            return robot, False
    elif not registration.allow_local_mac:
        identity.check_universal_mac(presented.mac)
    joining.check_key_is_free(tx, source, presented, is_authorized=True)
    row = robot or _add(tx, presented.mac, registration.name)
    return joining.admit(tx, source, row, presented, registration.credential), robot is None


def approve(tx: Transaction, source: Source, name: str, fingerprint: str) -> RobotRow:
    """Make this key the robot's own, be it the row's or a claim; raise NotPossibleError when it does not wait there.

    Approving the key that an active robot has changes nothing.
    """
    robot = _get(tx, name)
    check_not_disabled(robot)
    claim = _claim_of(tx, robot, fingerprint)
    if claim is not None:
        robots.remove_claim(tx, claim.id)
        robots.set_key(tx, robot.id, claim.key, claim.report)
    elif robot.fingerprint != fingerprint:
        raise NotPossibleError(_no_such_key(robot, fingerprint))
    elif robot.state == "active":
        return robot
    robots.set_state(tx, robot.id, "active")
    details: dict[str, object] = {"was": robot.state, "fingerprint": fingerprint}
    if claim is not None:
        details["replaced"] = robot.fingerprint
    audit.record(tx, source, "robot_approved", name, **details)
    return robots.get(tx, name)


def reject(tx: Transaction, source: Source, name: str, fingerprint: str) -> None:
    """Turn a waiting key away for good; raise NotPossibleError when it does not wait there.

    A row that nobody announced goes with it; an announced robot waits for its first key again.
    """
    robot = _get(tx, name)
    claim = _claim_of(tx, robot, fingerprint)
    if claim is not None:
        robots.reject_claim(tx, claim.id, robot.name, source.actor)
    else:
        _reject_own(tx, source, robot, fingerprint)
    audit.record(tx, source, "key_rejected", name, mac=robot.mac, fingerprint=fingerprint)


def disable(tx: Transaction, source: Source, name: str) -> RobotRow:
    """Disable a robot, whatever its key."""
    robot = _get(tx, name)
    if robot.state != "disabled":
        _change_state(tx, source, robot, "disabled", "robot_disabled")
    if robot.state == "pending":
        # Nobody approved this key, and `enable` must not do so in passing.
        robots.forget_key(tx, robot.id)
    return robots.get(tx, name)


def enable(tx: Transaction, source: Source, name: str) -> RobotRow:
    """Let a disabled robot in again; raise NotPossibleError when it is not disabled."""
    robot = _get(tx, name)
    if robot.state != "disabled":
        raise NotPossibleError(f"cannot enable robot {name}: it is {robot.state}, not disabled")
    # Without a key there is nothing yet that could prove to be this robot.
    state: State = "active" if robot.fingerprint else "pending"
    _change_state(tx, source, robot, state, "robot_enabled")
    return robots.get(tx, name)


def rename(tx: Transaction, source: Source, name: str, new_name: str) -> RobotRow:
    """Give a robot another name; raise RecordExistsError or RecordRefusedError."""
    robot = _get(tx, name)
    if new_name != name:
        robots.rename(tx, robot.id, new_name)
        audit.record(tx, source, "robot_renamed", new_name, was=name)
    return robots.get(tx, new_name)


def set_mac(
    tx: Transaction, source: Source, name: str, mac: str, *, allow_local_mac: bool = False
) -> RobotRow:
    """Give a robot another MAC; raise FieldInvalidError or RecordExistsError.

    An unknown robot that waits with this MAC does not matter: its row goes, and its key has to ask again.
    """
    robot = _get(tx, name)
    normal = identity.normalise_mac(mac, allow_local=allow_local_mac)
    if normal != robot.mac:
        waiting = robots.find_by_mac(tx, normal)
        if waiting is not None and waiting.is_unknown:
            robots.remove(tx, waiting.id)
            audit.record(
                tx,
                source,
                "key_released",
                waiting.name,
                mac=normal,
                fingerprint=waiting.fingerprint,
            )
        robots.set_mac(tx, robot.id, normal)
        audit.record(tx, source, "robot_mac_set", name, was=robot.mac, mac=normal)
    return robots.get(tx, name)


def move_ports(
    tx: Transaction,
    source: Source,
    name: str,
    ros_port: int | None = None,
    video_port: int | None = None,
) -> RobotRow:
    """Move a robot to these ports, or to another free pair; raise RecordExistsError or RecordRefusedError."""
    robot = _get(tx, name)
    robots.set_ports(tx, robot.id, ros_port, video_port)
    moved = robots.get(tx, name)
    audit.record(
        tx,
        source,
        "robot_ports_moved",
        name,
        was=[robot.ros_port, robot.video_port],
        ports=[moved.ros_port, moved.video_port],
    )
    return moved


def set_shell(tx: Transaction, source: Source, name: str, on: bool) -> RobotRow:
    """Forward a port to the robot's sshd, or stop doing so; raise RecordRefusedError when no port is free."""
    robot = _get(tx, name)
    if robot.shell == on:
        return robot
    robots.set_shell(tx, robot.id, on=on)
    changed = robots.get(tx, name)
    audit.record(
        tx, source, "robot_shell_set", name, shell=on, port=changed.shell_port or robot.shell_port
    )
    return changed


def change_settings(
    tx: Transaction,
    source: Source,
    name: str,
    change: Callable[[Settings], Settings],
    member: Literal["page", "buttons"] | None = None,
) -> RobotSettings:
    """Replace a robot's settings by what `change` makes of the present ones, of a `member` alone if one is named.

    {} means the defaults; only differences are stored. Returns what is in force then, and raises FieldInvalidError.
    No other change comes in between. Relay and guard follow by themselves.
    """
    robot = _get(tx, name)
    was, new = robot.settings, change(robot.settings)
    if member is not None:
        of_member = {key: value for key, value in new.items() if key == member}
        new = {key: value for key, value in was.items() if key != member} | of_member
    settings = robot_settings.parse(new)
    values = settings.as_given()
    before, after = (was, values) if member is None else (was.get(member), values.get(member))
    if not robot_settings.same_json(before, after):
        robots.set_settings(tx, robot.id, values)
        what = member or "settings"
        audit.record(tx, source, f"robot_{what}_set", name, **{"was": before, what: after})
    return settings


def rekey(tx: Transaction, source: Source, name: str) -> RobotRow:
    """Forget a robot's key and end its connection; the next key that joins waits for approval."""
    robot = _get(tx, name)
    robots.forget_key(tx, robot.id)
    if robot.state == "active":
        robots.set_state(tx, robot.id, "pending")
    audit.record(tx, source, "robot_rekeyed", name, was=robot.state, fingerprint=robot.fingerprint)
    return robots.get(tx, name)


def rotate_key(tx: Transaction, source: Source, name: str) -> RobotRow:
    """Ask the robot's agent to make a new key; raise NotPossibleError when the robot is not active."""
    robot = _get(tx, name)
    if robot.state != "active" or robot.fingerprint is None:
        raise NotPossibleError(
            f"cannot rotate the key of robot {name}: it is {robot.state}"
            f"{'' if robot.fingerprint else ' and has no key'}; only an active robot can prove a new key"
        )
    if robot.rotate_requested_at is None:
        robots.request_rotation(tx, robot.id)
        audit.record(tx, source, "robot_rotation_requested", name, fingerprint=robot.fingerprint)
    return robots.get(tx, name)


def remove(tx: Transaction, source: Source, name: str) -> RobotRow:
    """Remove a robot with its grants and its history; return it as it was."""
    robot = _get(tx, name)
    robots.remove(tx, robot.id)
    audit.record(
        tx,
        source,
        "robot_removed",
        name,
        was=robot.state,
        mac=robot.mac,
        fingerprint=robot.fingerprint,
    )
    return robot


def _get(tx: Transaction, name: str) -> RobotRow:
    robots.lock_enrolment(tx)
    return robots.get(tx, name)


def _claim_of(tx: Transaction, robot: RobotRow, fingerprint: str) -> Claim | None:
    claim = robots.find_claim(tx, fingerprint)
    return claim if claim is not None and claim.robot_id == robot.id else None


def check_not_disabled(robot: RobotRow) -> None:
    """Raise NotPossibleError for a robot whose keys cannot be approved."""
    if robot.state == "disabled":
        raise NotPossibleError(
            f"cannot approve robot {robot.name}: it is disabled; "
            f"use: robotether robot enable {robot.name}"
        )


def _no_such_key(robot: RobotRow, fingerprint: str) -> str:
    if robot.fingerprint is None:
        return f"cannot approve robot {robot.name}: no key {fingerprint} waits there; it has not joined yet"
    return (
        f"cannot approve robot {robot.name}: its key is {robot.fingerprint}, not {fingerprint}; if that is "
        "not the key that robotether-agent status shows on the robot, somebody else joined in its "
        f"name: robotether robot rekey {robot.name}"
    )


def _reject_own(tx: Transaction, source: Source, robot: RobotRow, fingerprint: str) -> None:
    if robot.key is None or robot.fingerprint != fingerprint or robot.report is None:
        raise NotPossibleError(
            f"cannot reject key {fingerprint}: it does not wait at robot {robot.name}"
        )
    if robot.state != "pending":
        raise NotPossibleError(
            f"cannot reject key {fingerprint}: robot {robot.name} is {robot.state} with it; forget the key "
            f"with: robotether robot rekey {robot.name}"
        )
    claim_id = robots.add_claim(tx, robot, robot.key, robot.report)
    robots.reject_claim(tx, claim_id, robot.name, source.actor)
    if robot.is_unknown:
        robots.remove(tx, robot.id)
    else:
        robots.forget_key(tx, robot.id)


def _change_state(
    tx: Transaction, source: Source, robot: RobotRow, state: State, kind: str
) -> None:
    robots.set_state(tx, robot.id, state)
    audit.record(tx, source, kind, robot.name, was=robot.state, fingerprint=robot.fingerprint)


def _add(tx: Transaction, mac: str, name: str) -> RobotRow:
    robots.add(tx, mac, name)
    return robots.get(tx, name)


def _check_may_register(robot: RobotRow, presented: joining.PresentedKey) -> None:
    if robot.state == "disabled":
        raise RobotDisabledError(
            f"cannot enrol robot {robot.name}: it is disabled; an admin enables it with: "
            f"robotether robot enable {robot.name}"
        )
    is_other = robot.fingerprint not in (None, presented.key.fingerprint)
    if robot.state == "active" and is_other:
        raise MacInUseError(
            f"cannot enrol MAC {presented.mac}: robot {robot.name} has it, with another key; if this is that robot "
            f"with a new disk, an admin forgets the old key with: robotether robot rekey {robot.name}"
        )


def _named(tx: Transaction, source: Source, robot: RobotRow, name: str) -> RobotRow:
    """Return the robot under the name that the playbook gives; only an unknown robot is renamed for it."""
    if robot.name == name:
        return robot
    if not robot.is_unknown:
        raise RecordExistsError(
            f"cannot enrol robot {name}: MAC {robot.mac} belongs to robot {robot.name}; use that name, or "
            f"rename it first"
        )
    robots.rename(tx, robot.id, name)
    audit.record(tx, source, "robot_renamed", name, was=robot.name)
    return robots.get(tx, name)
