"""Lets robots in: decides what a robot that shows a MAC and a key is told.

Used by api.py. A MAC only names a robot; its key is what proves it. A key waits until an admin
approves it, unless it comes with an API token of an admin, which approves at once. A join proves no
possession of the key, so one with a key that is known already must never change the row.
"""

import datetime as dt
from dataclasses import dataclass

from robotether_server.networks import network_of
from robotether_server.problems import (
    GrantMissing,
    KeyInUse,
    MacInUse,
    RecordExists,
    RobotDisabled,
    StoreUnavailable,
    TooManyPending,
)
from robotether_server.ssh_keys import PublicKey
from robotether_server.store import Transaction, audit, robots
from robotether_server.store.audit import Event, Source
from robotether_server.store.robots import Report, Robot
from robotether_server.store.users import User

SHORTEST_SUFFIX = 6
MAC_DIGITS = 12
# Robots that nobody announced: what one network may leave waiting, and for how long.
STRANGERS_PER_NETWORK = 10
STRANGER_LIFETIME = dt.timedelta(hours=24)


@dataclass(frozen=True)
class Request:
    """What a robot shows. `approver`: the admin whose token came with it."""

    mac: str
    key: PublicKey
    report: Report
    approver: User | None


def join(tx: Transaction, request: Request, max_pending: int) -> Robot:
    """Return the robot's record, pending or active, after writing down what is new.

    Raises RobotDisabled, MacInUse, KeyInUse, TooManyPending or GrantMissing.
    """
    if request.approver is not None and not request.approver.is_admin:
        raise GrantMissing("cannot join with this token: it must be one of an admin")
    robots.remove_strangers(tx, dt.datetime.now(dt.UTC) - STRANGER_LIFETIME)
    robot = robots.find_by_mac(tx, request.mac) or _add_stranger(tx, request, max_pending)
    if robot.state == "disabled":
        raise RobotDisabled(
            f"cannot join robot {robot.name}: it is disabled; an admin enables it with: "
            f"robotether robot enable {robot.name}"
        )
    if robot.fingerprint != request.key.fingerprint:
        _check_may_bring_key(robot, request)
        _take_key(tx, robot, request)
    if request.approver is not None and robot.state != "active":
        _approve(tx, robot, request.approver, request)
    return robots.get(tx, robot.name)


def _add_stranger(tx: Transaction, request: Request, max_pending: int) -> Robot:
    if request.approver is None:
        _check_room(robots.strangers(tx), request.report.address, max_pending)
    name = _free_name(tx, request.mac)
    try:
        robots.add(tx, request.mac, name, stranger=True)
    except RecordExists as error:
        # The same robot asked twice at once, and the other request was first.
        raise StoreUnavailable("cannot join: another join is at work; try again") from error
    return robots.get(tx, name)


def _check_room(waiting: list[str], address: str, max_pending: int) -> None:
    """Raise TooManyPending when all, or one network, have as many unknown robots waiting as may."""
    network = network_of(address)
    from_there = sum(network_of(other) == network for other in waiting)
    whose = (
        f"{len(waiting)}" if from_there < STRANGERS_PER_NETWORK else f"{from_there} from {network}"
    )
    if len(waiting) >= max_pending or from_there >= STRANGERS_PER_NETWORK:
        raise TooManyPending(
            f"cannot take another unknown robot: {whose} wait for approval already; an admin approves or "
            "removes some, or lets this one in beforehand with: robotether robot add NAME --mac MAC"
        )


def _free_name(tx: Transaction, mac: str) -> str:
    """Return robot- and the last digits of the MAC, as many as make it a new name."""
    digits = mac.replace(":", "")
    names = [f"robot-{digits[-count:]}" for count in range(SHORTEST_SUFFIX, MAC_DIGITS + 1)]
    return next((name for name in names if not robots.name_is_taken(tx, name)), names[-1])


def _check_may_bring_key(robot: Robot, request: Request) -> None:
    """Raise MacInUse unless the row has no key yet, or one that waits while an admin vouches for this one."""
    is_vouched = request.approver is not None and robot.state == "pending"
    if robot.fingerprint is not None and not is_vouched:
        raise MacInUse(
            f"cannot join with MAC {request.mac}: robot {robot.name} has it, with another key; if this is "
            f"that robot with a new key, an admin lets it in with: robotether robot rekey {robot.name}"
        )


def _take_key(tx: Transaction, robot: Robot, request: Request) -> None:
    """Write the key down. It waits for approval even when the row was active before."""
    try:
        robots.set_key(tx, robot.id, request.key, request.report)
    except RecordExists as error:
        raise KeyInUse(
            f"cannot join with MAC {request.mac}: the key belongs to a robot with another MAC; "
            "make a new key on this one"
        ) from error
    robots.set_state(tx, robot.id, "pending")
    details: dict[str, object] = {
        "mac": request.mac,
        "fingerprint": request.key.fingerprint,
        "hostname": request.report.hostname,
    }
    source = Source("robot", request.report.address)
    audit.record(tx, source, Event("robot_pending", robot.name, details))


def _approve(tx: Transaction, robot: Robot, approver: User, request: Request) -> None:
    robots.set_state(tx, robot.id, "active")
    details: dict[str, object] = {"by": "join token", "fingerprint": request.key.fingerprint}
    source = Source(approver.name, request.report.address)
    audit.record(tx, source, Event("robot_approved", robot.name, details))
