"""Keys that wait for an admin, rejected ones, and joins that were refused."""

import datetime as dt
from dataclasses import dataclass
from typing import Literal

from robotether_server.db import Transaction, audit, robots
from robotether_server.db.audit import Source, network_of
from robotether_server.db.robots import Claim, RefusedJoin, Report, RobotRow
from robotether_server.schemas import Fingerprint, RobotName, Timestamp
from robotether_server.services.joining import PresentedKey

Reason = Literal["approval_pending", "mac_in_use"]


@dataclass(frozen=True)
class PendingKey:
    """A key that waits; with `mac_in_use` the robot goes on with another key meanwhile."""

    robot: RobotName
    mac: str
    hostname: str
    address: str
    fingerprint: Fingerprint
    agent_version: str
    joined_at: Timestamp
    reason: Reason


@dataclass(frozen=True)
class RejectedKey:
    """A rejected key; `robot` is the name that its robot had then."""

    id: int
    fingerprint: Fingerprint
    robot: str
    mac: str
    hostname: str
    address: str
    rejected_at: Timestamp
    rejected_by: str


def waiting(tx: Transaction) -> list[PendingKey]:
    """Return every key that waits, the oldest first."""
    own = [_of_robot(robot) for robot in robots.list_waiting(tx)]
    claimed = [_of_claim(claim) for claim in robots.list_claims(tx)]
    return sorted((*own, *claimed), key=lambda key: key.joined_at)


def rejected(tx: Transaction) -> list[RejectedKey]:
    """Return every rejected key, the newest first."""
    return [_rejected(claim) for claim in robots.list_rejected_keys(tx)]


def refused(tx: Transaction) -> list[RefusedJoin]:
    """Return the joins that were refused within a day, the newest first."""
    return robots.list_refusals(tx, dt.datetime.now(dt.UTC) - robots.REFUSED_FOR)


def record_refusal(tx: Transaction, presented: PresentedKey, code: str, detail: str) -> None:
    """Keep why this robot was refused, for the admin who waits for it."""
    now, key = dt.datetime.now(dt.UTC), presented.key.fingerprint
    refusal = RefusedJoin(presented.mac, key, presented.report, code, detail, 1, now)
    robots.record_refusal(tx, refusal, str(network_of(presented.report.address)))


def forget_refusals(tx: Transaction, presented: PresentedKey) -> None:
    """Forget what was refused to a key that is in now, or waits."""
    robots.remove_refusals(tx, presented.mac, presented.key.fingerprint)


def host_key_refused(robot: str) -> str:
    """Say that a robot refuses the host key that it gets from SSH, and what to do."""
    return (
        f"robot {robot} does not connect: the SSH host key that it gets is not one of those pinned at its first join. "
        "Somebody may be posing as this server there. Only if its host keys were changed on purpose: remove "
        "/var/lib/robotether-agent/known_hosts on the robot, and start its agent again"
    )


def forgive(tx: Transaction, source: Source, rejected_id: int) -> RejectedKey:
    """Let a rejected key ask again, and return it; raise RecordMissingError."""
    claim = robots.get_rejected_key(tx, rejected_id)
    robots.remove_claim(tx, claim.id)
    audit.record(
        tx, source, "key_forgiven", claim.robot, mac=claim.mac, fingerprint=claim.key.fingerprint
    )
    return _rejected(claim)


def _of_robot(robot: RobotRow) -> PendingKey:
    return PendingKey(
        robot=robot.name,
        mac=robot.mac,
        fingerprint=robot.fingerprint or "",
        # A key that somebody wrote by SQL came with no join.
        joined_at=robot.joined_at or dt.datetime.fromtimestamp(0, dt.UTC),
        reason="approval_pending",
        **vars(robot.report or Report("", "", "")),
    )


def _of_claim(claim: Claim) -> PendingKey:
    return PendingKey(
        robot=claim.robot,
        mac=claim.mac,
        fingerprint=claim.key.fingerprint,
        joined_at=claim.claimed_at,
        reason="mac_in_use",
        **vars(claim.report),
    )


def _rejected(claim: Claim) -> RejectedKey:
    return RejectedKey(
        id=claim.id,
        fingerprint=claim.key.fingerprint,
        robot=claim.robot,
        mac=claim.mac,
        hostname=claim.report.hostname,
        address=claim.report.address,
        rejected_at=claim.rejected_at or claim.claimed_at,
        rejected_by=claim.rejected_by or "",
    )
