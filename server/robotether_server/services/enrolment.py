"""Makes a key a robot's own, for joins and playbooks. Its callers hold the enrolment lock.

A MAC only names a robot, and showing a public key proves nothing. So without a credential
(enrolment_credentials.py) a key only waits, and nothing that waits may keep a robot out that comes with one. The
key of an active robot is never replaced here.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, count

from robotether_server import macs, ssh_keys
from robotether_server.db import Transaction, audit, credentials, robots
from robotether_server.db.audit import Event, Source
from robotether_server.db.robots import Claim, Report, Robot
from robotether_server.problems import (
    KeyInUse,
    KeyRejected,
    MacInUse,
    RecordExists,
    RobotDisabled,
    TokenUsedUp,
)
from robotether_server.services.enrolment_credentials import EnrolmentCredential
from robotether_server.ssh_keys import PublicKey

ROBOT_NAME = re.compile(r"(?=.{1,63}\Z)[a-z0-9]([a-z0-9-]*[a-z0-9])?")
MIN_SUFFIX_LENGTH = 6
MAC_DIGITS = 12


@dataclass(frozen=True)
class PresentedKey:
    """What a robot shows and tells: its MAC (normalised), its key, and about itself."""

    mac: str
    key: PublicKey
    report: Report


@dataclass(frozen=True)
class Registration:
    """What PUT /api/v1/robots/NAME says. `credential` is of who may."""

    name: str
    mac: str
    public_key: str
    credential: EnrolmentCredential
    hostname: str | None = None
    agent_version: str | None = None
    allow_local_mac: bool = False


def register(tx: Transaction, source: Source, registration: Registration) -> tuple[Robot, bool]:
    """Make the robot active with this key, or find it so; tell whether its row was made for it."""
    presented = PresentedKey(
        mac=macs.normalise(registration.mac),
        key=ssh_keys.parse(registration.public_key),
        report=Report(
            registration.hostname or "", registration.agent_version or "", source.address or ""
        ),
    )
    check_not_rejected(tx, presented.key)
    found = robots.find_by_mac(tx, presented.mac)
    if found is not None:
        _check_may_register(found, presented)
        found = _named(tx, source, found, registration.name)
        if found.state == "active" and found.fingerprint == presented.key.fingerprint:
            return found, False
    elif not registration.allow_local_mac:
        macs.check_universal(presented.mac)
    check_key_is_free(tx, source, presented, is_authorized=True)
    row = found or _add(tx, presented.mac, registration.name)
    return let_in(tx, source, row, presented, registration.credential), found is None


def check_not_rejected(tx: Transaction, key: PublicKey) -> None:
    """Raise KeyRejected for a key that an admin turned away."""
    claim = robots.find_claim(tx, key.fingerprint)
    if claim is not None and claim.is_rejected:
        raise KeyRejected(
            f"cannot join with key {key.fingerprint}: an admin rejected it; make a new key on the robot "
            "(sudo robotether-agent forget), or ask an admin to remove it from the list of rejected keys"
        )


def check_key_is_free(
    tx: Transaction, source: Source, presented: PresentedKey, *, is_authorized: bool
) -> None:
    """Raise KeyInUse when the key stands at another MAC; where it only waits there, an authorized robot gets it."""
    holder = robots.find_by_key(tx, presented.key.fingerprint)
    claim = robots.find_claim(tx, presented.key.fingerprint)
    waits_elsewhere = holder is not None and holder.mac != presented.mac
    claimed_elsewhere = claim is not None and claim.mac != presented.mac
    if not waits_elsewhere and not claimed_elsewhere:
        return
    if not is_authorized or (waits_elsewhere and holder is not None and holder.state != "pending"):
        raise KeyInUse(
            f"cannot join with MAC {presented.mac}: the key belongs to a robot with another MAC; "
            "make a new key on this one"
        )
    _release(tx, source, holder, claim)


def let_in(
    tx: Transaction,
    source: Source,
    robot: Robot,
    presented: PresentedKey,
    credential: EnrolmentCredential | None,
) -> Robot:
    """Make the key the robot's own, and the robot active; None: JOIN_POLICY lets first keys in.

    Raises TokenUsedUp; a use of a join token is counted here and nowhere else.
    """
    if credential is not None and credential.token is not None:
        _count_use(tx, credential.token, presented.key)
    adopt_key(tx, robot, presented)
    robots.set_state(tx, robot.id, "active")
    details: dict[str, object] = {
        "was": robot.state,
        "mac": presented.mac,
        "fingerprint": presented.key.fingerprint,
        "hostname": presented.report.hostname,
        **(credential.details if credential else {"by": "first key"}),
    }
    audit.record(tx, source, Event("robot_approved", robot.name, details))
    return robots.get(tx, robot.name)


def adopt_key(tx: Transaction, robot: Robot, presented: PresentedKey) -> None:
    """Write the key into the row, unless it stands there: a known key changes nothing. Raises KeyInUse."""
    claim = robots.find_claim(tx, presented.key.fingerprint)
    if claim is not None:
        robots.remove_claim(tx, claim.id)
    if robot.fingerprint == presented.key.fingerprint:
        return
    try:
        robots.set_key(tx, robot.id, presented.key, presented.report)
    except RecordExists as error:
        # Only SQL written by hand comes in between: joins and admins hold the lock.
        raise KeyInUse(
            f"cannot join with MAC {presented.mac}: another robot has the key"
        ) from error


def is_spent(tx: Transaction, credential: EnrolmentCredential, key: PublicKey) -> bool:
    """Tell whether the join token let this key in before, which an admin has undone since."""
    return credential.token is not None and credentials.has_let_in(
        tx, credential.token.id, key.fingerprint
    )


def free_name(tx: Transaction, mac: str, requested: str | None = None) -> str:
    """Return the requested name if it can be had, or robot- and as many of the MAC's digits as make it a new name."""
    requested_names = (
        [requested] if requested is not None and ROBOT_NAME.fullmatch(requested) else []
    )
    names = chain(requested_names, usual_names(mac))
    return next(name for name in names if not robots.name_is_taken(tx, name))


def usual_names(mac: str) -> Iterator[str]:
    """Return names for an unknown robot, the shortest first; there is always another."""
    digits = mac.replace(":", "")
    for length in range(MIN_SUFFIX_LENGTH, MAC_DIGITS + 1):
        yield f"robot-{digits[-length:]}"
    for number in count(2):
        yield f"robot-{digits}-{number}"


def _add(tx: Transaction, mac: str, name: str) -> Robot:
    robots.add(tx, mac, name)
    return robots.get(tx, name)


def _check_may_register(found: Robot, presented: PresentedKey) -> None:
    if found.state == "disabled":
        raise RobotDisabled(
            f"cannot enrol robot {found.name}: it is disabled; an admin enables it with: "
            f"robotether robot enable {found.name}"
        )
    is_other = found.fingerprint not in (None, presented.key.fingerprint)
    if found.state == "active" and is_other:
        raise MacInUse(
            f"cannot enrol MAC {presented.mac}: robot {found.name} has it, with another key; if this is that robot "
            f"with a new disk, an admin forgets the old key with: robotether robot rekey {found.name}"
        )


def _named(tx: Transaction, source: Source, found: Robot, name: str) -> Robot:
    """Return the robot under the name that the playbook gives; only an unknown robot is renamed for it."""
    if found.name == name:
        return found
    if not found.is_unknown:
        raise RecordExists(
            f"cannot enrol robot {name}: MAC {found.mac} belongs to robot {found.name}; use that name, or "
            f"rename it first"
        )
    robots.rename(tx, found.id, name)
    audit.record(tx, source, Event("robot_renamed", name, {"was": found.name}))
    return robots.get(tx, name)


def _count_use(tx: Transaction, token: credentials.JoinToken, key: PublicKey) -> None:
    if credentials.has_let_in(tx, token.id, key.fingerprint):
        raise TokenUsedUp(
            f"cannot join with this token: it has admitted key {key.fingerprint} before, and an admin has undone "
            "that; get another token, or an admin's approval"
        )
    if not credentials.use_join_token(tx, token.id, key.fingerprint):
        raise TokenUsedUp(
            f"cannot join with this token: it was good for {token.uses} "
            f"{'robot' if token.uses == 1 else 'robots'}, which are in; make another"
        )


def _release(tx: Transaction, source: Source, holder: Robot | None, claim: Claim | None) -> None:
    if claim is not None:
        robots.remove_claim(tx, claim.id)
    if holder is None:
        return
    if holder.is_unknown:
        robots.remove(tx, holder.id)
    else:
        robots.forget_key(tx, holder.id)
    details: dict[str, object] = {"mac": holder.mac, "fingerprint": holder.fingerprint}
    audit.record(tx, source, Event("key_released", holder.name, details))
