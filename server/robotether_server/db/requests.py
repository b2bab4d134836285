"""Requests for help: who asked, who was offered each, and who accepted it.

Written by services; robots ask through the relay (db/fleet.py). Whoever changes one holds the lock of `lock`. All
times are of the database's clock.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection
from dataclasses import dataclass
from typing import Annotated, Literal

from msgspec import Meta

from robotether_server.db.database import Row, Transaction
from robotether_server.problems import RecordMissingError
from robotether_server.schemas import Amount, Count, Level, RobotName, Timestamp, UserName

RequestState = Literal["waiting", "offered", "accepted", "closed", "cancelled"]
RequestSource = Literal[
    "api", "page", "robot", "stop", "battery", "diagnostics", "geofence", "navigation"
]
Priority = Annotated[int, Meta(ge=1, le=3, description="1 is urgent, 3 is low")]

IS_OPEN = "h.state IN ('waiting', 'offered', 'accepted')"
IS_OF_ROBOT = "(%(robot)s IS NULL OR r.name = %(robot)s) AND (%(mac)s IS NULL OR r.mac = %(mac)s)"
# Its robots are those that the viewer may see.
SELECT = (
    "SELECT h.id, r.name AS robot, r.mac, h.reason, h.source, h.priority, h.pool, h.asked_by, h.created_at, "
    "TIMESTAMPDIFF(MICROSECOND, h.created_at, IFNULL(h.closed_at, CURRENT_TIMESTAMP(6))) / 1e6 AS age_s, "
    "h.state, o.name AS offered_to, h.offer_until, a.name AS accepted_by, h.accepted_at, h.closed_at, h.note, "
    "h.robot_id, h.accepted_by AS accepted_by_id, g.level, "
    "EXISTS (SELECT 1 FROM users v WHERE v.id = %(viewer)s AND v.name = h.asked_by AND v.created_at <= h.created_at) "
    "AND h.source IN ('api', 'page') AS is_own FROM help_requests h "
    "JOIN robots r ON r.id = h.robot_id "
    "JOIN (SELECT robot_id, level FROM relay_grants WHERE user_id = %(viewer)s) g ON g.robot_id = h.robot_id "
    "LEFT JOIN users o ON o.id = h.offered_to LEFT JOIN users a ON a.id = h.accepted_by "
)
ADD = (
    "CALL add_help_request(%(robot_id)s, %(source)s, %(reason)s, %(priority)s, %(pool)s, "
    "%(asked_by)s, %(address)s)"
)
# When the oldest records are from that are all still there; NULL: nothing is deleted.
CLOCK = (
    "SELECT UNIX_TIMESTAMP() AS now_s, (SELECT UNIX_TIMESTAMP() - 86400 * NULLIF(days, 0) FROM retention) "
    "AS kept_from_s"
)


def _by_period(at: str, facts: str, end: str) -> str:
    """Return a query of facts by the number of the period in which `at` is."""
    return (
        f"SELECT DISTINCT UNIX_TIMESTAMP(h.{at}) DIV %(length_s)s AS number, {facts} FROM help_requests h "  # noqa: S608 - the module's own text
        "JOIN (SELECT robot_id FROM relay_grants WHERE user_id = %(viewer)s) g ON g.robot_id = h.robot_id "
        f"WHERE h.{at} >= FROM_UNIXTIME(%(from_s)s) {end}"
    )


# Of one that was accepted last: after it was made, or let go by whom had it before.
WAITED_S = "TIMESTAMPDIFF(MICROSECOND, COALESCE(h.waits_since, h.created_at), h.accepted_at) / 1e6"
# A request that somebody has accepted waits from now on.
WAITS_SINCE = "waits_since = IF(state = 'accepted', CURRENT_TIMESTAMP(6), waits_since)"


def _quantile(share: float) -> str:
    number = "UNIX_TIMESTAMP(h.accepted_at) DIV %(length_s)s"
    return (
        f"PERCENTILE_DISC({share}) WITHIN GROUP (ORDER BY {WAITED_S}) OVER (PARTITION BY {number})"
    )


MADE = _by_period("created_at", "CAST(COUNT(*) AS INT) AS made", "GROUP BY number")
ENDED = _by_period(
    "closed_at",
    "CAST(SUM(h.state = 'closed') AS INT) AS closed, CAST(SUM(h.state = 'cancelled') AS INT) AS cancelled",
    "GROUP BY number",
)
WAITS = _by_period(
    "accepted_at", f"{_quantile(0.5)} AS waiting_p50_s, {_quantile(0.95)} AS waiting_p95_s", ""
)


@dataclass(frozen=True)
class HelpRequest:
    """A robot that needs a person. `pool` is empty if every operator may take it.

    `age_s` counts until it is closed. `offered_to` and `offer_until` are set while it is offered.
    """

    id: Count
    robot: RobotName
    mac: str
    reason: str
    source: RequestSource
    priority: Priority
    pool: str
    asked_by: str
    created_at: Timestamp
    age_s: Amount
    state: RequestState
    offered_to: UserName | None
    offer_until: Timestamp | None
    accepted_by: UserName | None
    accepted_at: Timestamp | None
    closed_at: Timestamp | None
    note: str | None

    @property
    def is_open(self) -> bool:
        """Whether it is neither closed nor cancelled."""
        return self.closed_at is None


@dataclass(frozen=True)
class SeenRequest:
    """A request as one user sees it, with that user's level on its robot.

    `is_own`: this user asked, and not a removed one of the same name.
    """

    request: HelpRequest
    level: Level
    robot_id: int
    accepted_by_id: int | None
    is_own: bool


@dataclass(frozen=True)
class NewRequest:
    """What a person asks for; `source` is page or api."""

    robot_id: int
    reason: str
    source: RequestSource
    priority: int
    pool: str
    asked_by: str
    address: str | None


@dataclass(frozen=True)
class OpenRequest:
    """An open request as the planner sees it, by ids; `user` names the person who got its offer or accepted it."""

    id: int
    robot_id: int
    robot: str
    robot_state: str
    priority: int
    pool: str
    created_at: dt.datetime
    state: RequestState
    offered_to: int | None
    offer_until: dt.datetime | None
    accepted_by: int | None
    user: str | None


@dataclass(frozen=True)
class Figures:
    """How long requests waited that were accepted in a time, and what is open now; null: there were none."""

    waiting_p50_s: Amount | None
    waiting_p95_s: Amount | None
    answered: Count
    open: Count
    oldest_open_s: Amount | None


@dataclass(frozen=True)
class RequestPeriod:
    """What became of requests in one hour or day of UTC; counts are null where records may be deleted already.

    `made`, `closed` and `cancelled` count what happened then, the waits are of those that were accepted then, null:
    none was.
    """

    begins_at: Timestamp
    made: Count | None
    closed: Count | None
    cancelled: Count | None
    waiting_p50_s: Amount | None
    waiting_p95_s: Amount | None


def lock(tx: Transaction) -> None:
    """Make all changes of requests take turns, until the transaction ends."""
    tx.row("SELECT id FROM planner WHERE id = 1 FOR UPDATE")


def lock_to_plan(tx: Transaction, every_s: float) -> dt.datetime | None:
    """Take the same lock if the last plan is that old; return the time.

    None: it is newer, or somebody else has the lock, for which nobody waits here.
    """
    # A standby's clock may be behind that of the database which it replaced.
    row = tx.row(
        "SELECT CURRENT_TIMESTAMP(6) AS now FROM planner WHERE id = 1 AND NOT planned_at BETWEEN "
        "CURRENT_TIMESTAMP(6) - INTERVAL %s MICROSECOND AND CURRENT_TIMESTAMP(6) FOR UPDATE SKIP LOCKED",
        (int(every_s * 1e6),),
    )
    return None if row is None else row["now"]


def set_planned(tx: Transaction, now: dt.datetime) -> None:
    """Note the time of a plan."""
    tx.change("UPDATE planner SET planned_at = %s WHERE id = 1", (now,))


def add(tx: Transaction, request: NewRequest) -> tuple[int | None, bool]:
    """Add a request, or find the open one of this robot and source; return its id, and whether it is new.

    None: the robot has too many.
    """
    row = tx.row(ADD, vars(request)) or {"id": None, "is_new": False}
    return row["id"], bool(row["is_new"])


def get(tx: Transaction, viewer_id: int, request_id: int) -> SeenRequest:
    """Return a request; raise RecordMissingError when there is none that the viewer may see."""
    values = {"viewer": viewer_id, "id": request_id}
    row = tx.row(SELECT + "WHERE h.id = %(id)s", values)
    if row is None:
        raise RecordMissingError(
            f"cannot find request {request_id}: there is none that you may see"
        )
    return _seen(row)


def list_open(
    tx: Transaction, viewer_id: int, robot: str | None = None, mac: str | None = None
) -> list[SeenRequest]:
    """Return the open requests that the viewer may see, the most urgent first, then the oldest."""
    if tx.row(f"SELECT 1 FROM help_requests h WHERE {IS_OPEN} LIMIT 1") is None:  # noqa: S608 - the module's own text
        # Rights cost much more, and queues are read each second.
        return []
    rows = tx.rows(
        SELECT + f"WHERE {IS_OPEN} AND {IS_OF_ROBOT} ORDER BY h.priority, h.created_at, h.id",
        {"viewer": viewer_id, "robot": robot, "mac": mac},
    )
    return [_seen(row) for row in rows]


def list_closed(
    tx: Transaction,
    viewer_id: int,
    robot: str | None = None,
    mac: str | None = None,
    *,
    limit: int = 100,
) -> list[SeenRequest]:
    """Return the requests that were closed last and that the viewer may see, the newest first."""
    rows = tx.rows(
        SELECT
        + f"WHERE h.closed_at IS NOT NULL AND {IS_OF_ROBOT} "
        + "ORDER BY h.closed_at DESC, h.id DESC LIMIT %(limit)s",
        {"viewer": viewer_id, "robot": robot, "mac": mac, "limit": limit},
    )
    return [_seen(row) for row in rows]


def read_open(tx: Transaction) -> list[OpenRequest]:
    """Read all open requests, the most urgent first, then the oldest."""
    rows = tx.rows(
        "SELECT h.id, h.robot_id, r.name AS robot, r.state AS robot_state, h.priority, h.pool, h.created_at, "  # noqa: S608 - as above
        "h.state, h.offered_to, h.offer_until, h.accepted_by, u.name AS user FROM help_requests h "
        "JOIN robots r ON r.id = h.robot_id LEFT JOIN users u ON u.id = COALESCE(h.offered_to, h.accepted_by) "
        f"WHERE {IS_OPEN} ORDER BY h.priority, h.created_at, h.id"
    )
    return [OpenRequest(**row) for row in rows]


def read_passes(tx: Transaction, request_ids: Collection[int]) -> dict[int, dict[int, dt.datetime]]:
    """Read when which user passed each of these requests last, by the ids of request and user."""
    if not request_ids:
        return {}
    passes: dict[int, dict[int, dt.datetime]] = {}
    for row in tx.rows(
        "SELECT request_id, user_id, passed_at FROM help_request_passes WHERE request_id IN %s",
        (tuple(request_ids),),
    ):
        passes.setdefault(row["request_id"], {})[row["user_id"]] = row["passed_at"]
    return passes


def forget_passes(tx: Transaction, user_id: int) -> None:
    """Forget which requests a user passed."""
    tx.change("DELETE FROM help_request_passes WHERE user_id = %s", (user_id,))


def offer(tx: Transaction, request_id: int, user_id: int, for_s: float) -> None:
    """Offer a request to a user, in place of whoever had it."""
    tx.change(
        f"UPDATE help_requests SET {WAITS_SINCE}, state = 'offered', offered_to = %s, accepted_by = NULL, "  # noqa: S608 - as above
        "accepted_at = NULL, offer_until = CURRENT_TIMESTAMP(6) + INTERVAL %s MICROSECOND WHERE id = %s",
        (user_id, int(for_s * 1e6), request_id),
    )


def accept(tx: Transaction, request_id: int, user_id: int) -> bool:
    """Give a request to the user whom it is offered to; return whether that is so, and the offer is not over."""
    is_accepted = tx.change(
        "UPDATE help_requests SET state = 'accepted', accepted_by = offered_to, accepted_at = CURRENT_TIMESTAMP(6), "
        "offered_to = NULL, offer_until = NULL "
        "WHERE id = %s AND state = 'offered' AND offered_to = %s AND offer_until > CURRENT_TIMESTAMP(6)",
        (request_id, user_id),
    )
    if is_accepted:
        tx.change("DELETE FROM help_request_passes WHERE request_id = %s", (request_id,))
    return bool(is_accepted)


def wait_again(tx: Transaction, request_id: int, passed_by: int | None = None) -> None:
    """Take a request from whoever had it; `passed_by` is the user who passed it."""
    tx.change(
        f"UPDATE help_requests SET {WAITS_SINCE}, state = 'waiting', offered_to = NULL, offer_until = NULL, "  # noqa: S608 - as above
        "accepted_by = NULL, accepted_at = NULL WHERE id = %s",
        (request_id,),
    )
    if passed_by is not None:
        tx.change(
            "INSERT INTO help_request_passes (request_id, user_id) VALUES (%s, %s) "
            "ON DUPLICATE KEY UPDATE passed_at = CURRENT_TIMESTAMP(6)",
            (request_id, passed_by),
        )


def end(
    tx: Transaction,
    request_id: int,
    state: Literal["closed", "cancelled"],
    note: str | None = None,
) -> None:
    """Write that a request is over."""
    tx.change(
        "UPDATE help_requests SET state = %s, note = %s, closed_at = CURRENT_TIMESTAMP(6), "
        "offered_to = NULL, offer_until = NULL WHERE id = %s",
        (state, note, request_id),
    )


def read_waits(tx: Transaction, viewer_id: int, hours: int) -> list[float]:
    """Return for how many seconds each request waited that was accepted in the last hours, in order."""
    rows = tx.rows(
        f"SELECT {WAITED_S} AS waited_s FROM help_requests h "  # noqa: S608 - as above
        "JOIN (SELECT robot_id FROM relay_grants WHERE user_id = %s) g ON g.robot_id = h.robot_id "
        "WHERE h.accepted_at > CURRENT_TIMESTAMP(6) - INTERVAL %s HOUR ORDER BY waited_s",
        (viewer_id, hours),
    )
    return [row["waited_s"] for row in rows]


def read_periods(tx: Transaction, viewer_id: int, length_s: int, count: int) -> list[RequestPeriod]:
    """Return what became of requests that the viewer may see in each of the last periods, the oldest first.

    A period is a multiple of its length since 1970; the last one is not over.
    """
    clock = tx.row(CLOCK) or {}
    last = int(clock["now_s"] // length_s)
    first = last - count + 1
    values = {"viewer": viewer_id, "length_s": length_s, "from_s": first * length_s}
    periods = {
        number: {"made": 0, "closed": 0, "cancelled": 0} for number in range(first, last + 1)
    }
    for query in (MADE, ENDED, WAITS):
        for row in tx.rows(query, values):
            periods.get(row.pop("number"), {}).update(row)
    kept_from_s = clock["kept_from_s"] or 0
    return [
        _period(number * length_s, facts if number * length_s >= kept_from_s else {})
        for number, facts in periods.items()
    ]


def _period(begins_s: int, facts: Row) -> RequestPeriod:
    names = ("made", "closed", "cancelled", "waiting_p50_s", "waiting_p95_s")
    return RequestPeriod(
        dt.datetime.fromtimestamp(begins_s, dt.UTC), *(facts.get(name) for name in names)
    )


def _seen(row: Row) -> SeenRequest:
    members = dict(row)
    level, robot_id, accepted_by_id, is_own = (
        members.pop(name) for name in ("level", "robot_id", "accepted_by_id", "is_own")
    )
    return SeenRequest(HelpRequest(**members), level, robot_id, accepted_by_id, bool(is_own))
