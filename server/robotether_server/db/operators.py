"""Operators: users who have opened the queue, what they do now, and the pools that they belong to.

Written by services. All times are of the database's clock.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection
from dataclasses import dataclass

from robotether_server.db import cells
from robotether_server.db.database import Row, Transaction

# Whoever opens the robot of an offer is not busy with another one. A lease of a user's routes has another name.
DRIVES_SINCE = (
    "(SELECT MIN(s.since) FROM control_leases s "  # noqa: S608 - the modules' own text
    "WHERE s.user_id = o.user_id AND s.user_name = u.name AND s.ended_at IS NULL "
    f"AND {cells.IS_OF_LIVE_CELL} AND NOT EXISTS (SELECT 1 FROM help_requests h "
    "WHERE h.state = 'offered' AND h.offered_to = o.user_id AND h.robot_id = s.robot_id))"
)
SELECT = (
    "SELECT o.user_id, u.name AS user, o.available, o.last_seen_at, o.idle_since, o.wrap_up_until, "  # noqa: S608 - as above
    "(SELECT MIN(h.accepted_at) FROM help_requests h WHERE h.state = 'accepted' AND h.accepted_by = o.user_id) "
    f"AS accepted_at, {DRIVES_SINCE} AS drives_since, CURRENT_TIMESTAMP(6) AS now "
    "FROM operators o JOIN users u ON u.id = o.user_id AND NOT u.disabled "
)


@dataclass(frozen=True)
class OperatorRow:
    """One operator at the time `now`.

    `available` is what the user chose. `accepted_at`: of the request that the user has; `drives_since`: of the lease.
    """

    user_id: int
    user: str
    available: bool
    last_seen_at: dt.datetime
    idle_since: dt.datetime
    wrap_up_until: dt.datetime | None
    accepted_at: dt.datetime | None
    drives_since: dt.datetime | None
    now: dt.datetime

    @property
    def unseen_s(self) -> float:
        """The time since the last heartbeat, in seconds."""
        return (self.now - self.last_seen_at).total_seconds()

    @property
    def busy_since(self) -> dt.datetime | None:
        """Since when the user has a request or drives; None: neither."""
        return self.accepted_at or self.drives_since

    @property
    def wrap_up_left_s(self) -> float:
        """The time that is left to wrap up, in seconds; 0: none."""
        if self.wrap_up_until is None:
            return 0.0
        return max((self.wrap_up_until - self.now).total_seconds(), 0.0)


def find(tx: Transaction, user_id: int) -> OperatorRow | None:
    """Return an operator, locked until the transaction ends; None: the user has not opened the queue yet."""
    if tx.row("SELECT 1 FROM operators WHERE user_id = %s FOR UPDATE", (user_id,)) is None:
        return None
    row = tx.row(SELECT + "WHERE o.user_id = %s", (user_id,))
    return None if row is None else _operator(row)


def list_all(tx: Transaction) -> list[OperatorRow]:
    """Return all operators, by name."""
    return [_operator(row) for row in tx.rows(SELECT + "ORDER BY u.name")]


def list_seen_within(tx: Transaction, seconds: float) -> list[OperatorRow]:
    """Return the operators with a heartbeat in this time."""
    rows = tx.rows(
        SELECT + "WHERE o.last_seen_at > CURRENT_TIMESTAMP(6) - INTERVAL %s MICROSECOND",
        (int(seconds * 1e6),),
    )
    return [_operator(row) for row in rows]


def set_away(tx: Transaction, user_id: int) -> None:
    """Write that the user is away, as if it had been chosen."""
    tx.change(
        "UPDATE operators SET available = FALSE, idle_since = CURRENT_TIMESTAMP(6) "
        "WHERE user_id = %s AND available",
        (user_id,),
    )


def write_heartbeat(tx: Transaction, user_id: int, *, available: bool, is_idle: bool) -> None:
    """Write that the user is there; `is_idle`: as before, without a break."""
    is_written = tx.change(
        "UPDATE operators SET available = %s, last_seen_at = CURRENT_TIMESTAMP(6), "
        "idle_since = IF(%s, idle_since, CURRENT_TIMESTAMP(6)) WHERE user_id = %s",
        (available, is_idle, user_id),
    )
    if not is_written:
        # Not each time: it locks the user's row, which an admin may be about to remove.
        tx.change(
            "INSERT INTO operators (user_id, available) VALUES (%s, %s) "
            "ON DUPLICATE KEY UPDATE available = VALUES(available)",
            (user_id, available),
        )


def set_wrap_up(tx: Transaction, user_id: int, for_s: float) -> None:
    """Begin a user's time to wrap up; 0 ends it."""
    tx.change(
        "UPDATE operators SET wrap_up_until = CURRENT_TIMESTAMP(6) + INTERVAL %s MICROSECOND WHERE user_id = %s",
        (int(for_s * 1e6), user_id),
    )


def read_rights(
    tx: Transaction, user_ids: Collection[int], robot_ids: Collection[int]
) -> dict[int, frozenset[int]]:
    """Return which of these robots each of these users may drive."""
    rights: dict[int, set[int]] = {user_id: set() for user_id in user_ids}
    if user_ids and robot_ids:
        for row in tx.rows(
            "SELECT user_id, robot_id FROM relay_grants "
            "WHERE level <> 'observe' AND user_id IN %s AND robot_id IN %s",
            (tuple(user_ids), tuple(robot_ids)),
        ):
            rights[row["user_id"]].add(row["robot_id"])
    return {user_id: frozenset(robot_ids) for user_id, robot_ids in rights.items()}


def count_sharing(tx: Transaction, user_id: int, others: Collection[int]) -> int:
    """Return how many of these users may drive a robot that the user may drive."""
    if not others:
        return 0
    row = tx.row(
        "SELECT COUNT(DISTINCT o.user_id) AS sharing FROM relay_grants o "
        "JOIN relay_grants g ON g.robot_id = o.robot_id "
        "WHERE o.user_id IN %s AND o.level <> 'observe' AND g.user_id = %s AND g.level <> 'observe'",
        (tuple(others), user_id),
    )
    return 0 if row is None else int(row["sharing"])


def list_managed(tx: Transaction, user_id: int) -> frozenset[int]:
    """Return the ids of the robots that a user manages."""
    rows = tx.rows(
        "SELECT robot_id FROM relay_grants WHERE user_id = %s AND level = 'manage'", (user_id,)
    )
    return frozenset(row["robot_id"] for row in rows)


def read_pools(tx: Transaction) -> dict[int, list[str]]:
    """Return the pools of each user who has any, by name."""
    pools: dict[int, list[str]] = {}
    for row in tx.rows("SELECT user_id, pool FROM pool_members ORDER BY pool"):
        pools.setdefault(row["user_id"], []).append(row["pool"])
    return pools


def set_pools(tx: Transaction, user_id: int, pools: Collection[str]) -> None:
    """Replace a user's pools."""
    tx.change("DELETE FROM pool_members WHERE user_id = %s", (user_id,))
    tx.change_many(
        "INSERT INTO pool_members (user_id, pool) VALUES (%s, %s)",
        [(user_id, pool) for pool in pools],
    )


def _operator(row: Row) -> OperatorRow:
    return OperatorRow(**row | {"available": bool(row["available"])})
