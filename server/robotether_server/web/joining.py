"""Lets robots in: decides what a robot that shows a MAC and a key is told.

Used by api.py. A MAC only names a robot; its key is what proves it. A key waits until an admin
approves it, unless it comes with an API token of an admin, which approves at once.
"""

from dataclasses import dataclass

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


@dataclass(frozen=True)
class Request:
    """What a robot shows. `approver`: the admin whose token came with it."""

    mac: str
    key: PublicKey
    report: Report
    approver: User | None


def join(tx: Transaction, request: Request, max_pending: int) -> Robot:
    """Return the robot's record, pending or active, after writing down what it showed.

    Raises RobotDisabled, MacInUse, KeyInUse, TooManyPending or GrantMissing.
    """
    if request.approver is not None and not request.approver.is_admin:
        raise GrantMissing("cannot join with this token: it must be one of an admin")
    robot = robots.find_by_mac(tx, request.mac)
    if robot is None:
        robot = _add_unknown(tx, request, max_pending)
    elif robot.state == "disabled":
        raise RobotDisabled(
            f"cannot join robot {robot.name}: it is disabled; an admin enables it with: "
            f"robotether robot enable {robot.name}"
        )
    if robot.fingerprint is None:
        _take_key(tx, robot, request)
    elif robot.fingerprint != request.key.fingerprint:
        raise MacInUse(
            f"cannot join with MAC {request.mac}: robot {robot.name} has it, with another key"
        )
    robots.set_report(tx, robot.id, request.report)
    if request.approver is not None and robot.state != "active":
        _approve(tx, robot, request)
    return robots.get(tx, robot.name)


def _add_unknown(tx: Transaction, request: Request, max_pending: int) -> Robot:
    if request.approver is None and robots.count_pending(tx) >= max_pending:
        raise TooManyPending(
            f"cannot take another unknown robot: {max_pending} wait for approval already; "
            "an admin approves or removes some first"
        )
    name = _free_name(tx, request.mac)
    try:
        robots.add(tx, request.mac, name)
    except RecordExists as error:
        # The same robot asked twice at once, and the other request was first.
        raise StoreUnavailable("cannot join: another join is at work; try again") from error
    return robots.get(tx, name)


def _free_name(tx: Transaction, mac: str) -> str:
    """Return robot- and the last digits of the MAC, as many as make it a new name."""
    digits = mac.replace(":", "")
    names = [f"robot-{digits[-count:]}" for count in range(SHORTEST_SUFFIX, MAC_DIGITS + 1)]
    return next((name for name in names if not robots.name_is_taken(tx, name)), names[-1])


def _take_key(tx: Transaction, robot: Robot, request: Request) -> None:
    """Write the first key down. It waits for approval even when the row was active before."""
    try:
        robots.set_key(tx, robot.id, request.key)
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


def _approve(tx: Transaction, robot: Robot, request: Request) -> None:
    robots.set_state(tx, robot.id, "active")
    actor = request.approver.name if request.approver else "robot"
    source = Source(actor, request.report.address)
    audit.record(tx, source, Event("robot_approved", robot.name, {"by": "join token"}))
