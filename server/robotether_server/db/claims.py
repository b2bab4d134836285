"""Keys that no robot has: claims, which wait because the MAC's robot has another key, and rejected keys.

Written by services. A claim goes with its robot's row; a rejected key outlives it.
"""

import datetime as dt
from dataclasses import dataclass

from robotether_server.db.database import Row, Transaction
from robotether_server.db.robots import Report, Robot
from robotether_server.problems import RecordMissing
from robotether_server.ssh_keys import PublicKey

# While a claim waits its robot may get another name; a rejected key keeps the name of its time.
SELECT = (
    "SELECT c.id, c.fingerprint, c.public_key, c.robot_id, COALESCE(r.name, c.robot) AS robot, c.mac, "
    "c.hostname, c.agent_version, c.address, c.claimed_at, c.rejected_at, c.rejected_by "
    "FROM key_claims c LEFT JOIN robots r ON r.id = c.robot_id "
)


@dataclass(frozen=True)
class Claim:
    """A key that waits (`robot_id`) or was turned away (`rejected_at`, `rejected_by`)."""

    id: int
    key: PublicKey
    robot_id: int | None
    robot: str
    mac: str
    report: Report
    claimed_at: dt.datetime
    rejected_at: dt.datetime | None
    rejected_by: str | None

    @property
    def is_rejected(self) -> bool:
        """Whether an admin turned the key away."""
        return self.rejected_at is not None


def _claim(row: Row) -> Claim:
    return Claim(
        id=row["id"],
        key=PublicKey(row["public_key"], row["fingerprint"]),
        robot_id=row["robot_id"],
        robot=row["robot"],
        mac=row["mac"],
        report=Report(row["hostname"] or "", row["agent_version"] or "", row["address"] or ""),
        claimed_at=row["claimed_at"],
        rejected_at=row["rejected_at"],
        rejected_by=row["rejected_by"],
    )


def find(tx: Transaction, fingerprint: str) -> Claim | None:
    """Return the claim or rejected key of that fingerprint, locked until the transaction ends."""
    row = tx.row(SELECT + "WHERE c.fingerprint = %s FOR UPDATE", (fingerprint,))
    return _claim(row) if row else None


def add(tx: Transaction, robot: Robot, key: PublicKey, report: Report) -> None:
    """Write down that a key wants to be the one of that robot. Raises RecordExists."""
    tx.insert(
        "INSERT INTO key_claims "
        "(robot_id, robot, mac, fingerprint, public_key, hostname, agent_version, address) "
        "VALUES (%s, %s, %s, %s, %s, %s, %s, %s)",
        (
            robot.id,
            robot.name,
            robot.mac,
            key.fingerprint,
            key.line,
            report.hostname,
            report.agent_version,
            report.address,
        ),
    )


def add_rejected(tx: Transaction, robot: Robot, by: str) -> None:
    """Remember the key that this robot's row had as turned away. Raises RecordExists."""
    report = robot.report
    tx.insert(
        "INSERT INTO key_claims (robot, mac, fingerprint, public_key, hostname, agent_version, address, "
        "rejected_at, rejected_by) VALUES (%s, %s, %s, %s, %s, %s, %s, CURRENT_TIMESTAMP(6), %s)",
        (
            robot.name,
            robot.mac,
            robot.fingerprint,
            robot.public_key,
            report.hostname if report else None,
            report.agent_version if report else None,
            report.address if report else None,
            by,
        ),
    )


def reject(tx: Transaction, claim_id: int, robot: str, by: str) -> None:
    """Turn a claim away; its key is remembered."""
    tx.change(
        "UPDATE key_claims SET robot_id = NULL, robot = %s, rejected_at = CURRENT_TIMESTAMP(6), "
        "rejected_by = %s WHERE id = %s",
        (robot, by, claim_id),
    )


def remove(tx: Transaction, claim_id: int) -> None:
    """Forget a claim or a rejected key."""
    tx.change("DELETE FROM key_claims WHERE id = %s", (claim_id,))


def remove_old(tx: Transaction, before: dt.datetime) -> None:
    """Remove the claims that came before that moment; rejected keys stay."""
    tx.change("DELETE FROM key_claims WHERE rejected_at IS NULL AND claimed_at < %s", (before,))


def waiting(tx: Transaction) -> list[Claim]:
    """Return the claims, the oldest first."""
    return [_claim(row) for row in tx.rows(SELECT + "WHERE c.rejected_at IS NULL ORDER BY c.id")]


def rejected(tx: Transaction) -> list[Claim]:
    """Return the keys that were turned away, the newest first."""
    rows = tx.rows(
        SELECT + "WHERE c.rejected_at IS NOT NULL ORDER BY c.rejected_at DESC, c.id DESC"
    )
    return [_claim(row) for row in rows]


def get_rejected(tx: Transaction, claim_id: int) -> Claim:
    """Return the rejected key of that id; raise RecordMissing."""
    row = tx.row(SELECT + "WHERE c.id = %s AND c.rejected_at IS NOT NULL FOR UPDATE", (claim_id,))
    if row is None:
        raise RecordMissing(f"cannot find rejected key {claim_id}: there is none of that number")
    return _claim(row)
