"""Routes between robots and web apps: web makes and deletes them, the relay reads those that last, and ends some."""

from dataclasses import dataclass
from datetime import datetime

from robotether_server.db import audit
from robotether_server.db.audit import Source
from robotether_server.db.database import Transaction
from robotether_server.problems import RecordMissingError
from robotether_server.schemas import APP, RouteEndName, Timestamp, UserName

SELECT = (
    f"SELECT t.id, COALESCE(source.name, CONCAT('{APP}', t.source_app)) AS source, t.source_topic, "  # noqa: S608 - the module's own text
    f"COALESCE(target.name, CONCAT('{APP}', t.target_app)) AS target, t.target_topic, t.type, t.rate_hz, "
    "u.name AS made_by, t.made_at, t.ends_at, "
    "COALESCE(t.ended_at, IF(t.ends_at <= CURRENT_TIMESTAMP(6), t.ends_at, NULL)) AS ended_at, "
    "COALESCE(t.end_code, IF(t.ends_at <= CURRENT_TIMESTAMP(6), 'expired', NULL)) AS end_code "
    "FROM routes t LEFT JOIN robots source ON source.id = t.source_id "
    "LEFT JOIN robots target ON target.id = t.target_id JOIN users u ON u.id = t.user_id "
)
LASTS = "t.ended_at IS NULL AND (t.ends_at IS NULL OR t.ends_at > CURRENT_TIMESTAMP(6))"


@dataclass(frozen=True)
class Route:
    """A route, by the names of its ends and its maker; `ended_at` and `end_code` are None while it lasts."""

    id: int
    source: RouteEndName
    source_topic: str
    target: RouteEndName
    target_topic: str
    type: str
    rate_hz: float
    made_by: UserName
    made_at: Timestamp
    ends_at: Timestamp | None = None
    ended_at: Timestamp | None = None
    end_code: str | None = None


@dataclass(frozen=True)
class NewRoute:
    """A route that is about to be made, by the ids of its robots and its maker.

    An end without a robot is the app of that name; one end is a robot.
    """

    source_id: int | None
    source_topic: str
    target_id: int | None
    target_topic: str
    type: str
    rate_hz: float
    user_id: int
    ends_at: datetime | None = None
    source_app: str | None = None
    target_app: str | None = None

    @property
    def robot_ids(self) -> list[int]:
        """Its robots, the source first."""
        return [each for each in (self.source_id, self.target_id) if each is not None]


@dataclass(frozen=True)
class RelayRoute(NewRoute):
    """A route that lasts, as the relay reads it."""

    id: int = 0
    user_name: str = ""


@dataclass(frozen=True)
class RouteEnd:
    """A route that the relay has ended: of whom, between which ends, and why."""

    route_id: int
    ended_at: datetime
    code: str
    user: str
    source: str
    target: str


def is_app(end: str) -> bool:
    """Return whether an end of a route is a web app, by its name."""
    return end.startswith(APP)


def audited_robot(source: str, target: str) -> str:
    """Return in whose audit log a route between two ends is: in its target's, if that is a robot."""
    return source if is_app(target) else target


def list_all(tx: Transaction) -> list[Route]:
    """Return every route, those that last before those that ended, the newest first."""
    return [Route(**row) for row in tx.rows(f"{SELECT} ORDER BY NOT ({LASTS}), t.id DESC")]


def get(tx: Transaction, route_id: int) -> Route:
    """Return one route; raise RecordMissingError."""
    row = tx.row(f"{SELECT} WHERE t.id = %s", (route_id,))
    if row is None:
        raise RecordMissingError(f"cannot find route {route_id}: there is none of that number")
    return Route(**row)


def add(tx: Transaction, route: NewRoute) -> int:
    """Add a route; return its id."""
    return tx.add("routes", vars(route))


def remove(tx: Transaction, route_id: int) -> None:
    """Remove a route, which ends it."""
    tx.change("DELETE FROM routes WHERE id = %s", (route_id,))


def read_lasting(tx: Transaction) -> tuple[RelayRoute, ...]:
    """Return the routes that last, the oldest first; for the relay."""
    rows = tx.rows(
        "SELECT id, source_id, source_app, source_topic, target_id, target_app, target_topic, type, rate_hz, user_id, "
        "user_name, ends_at FROM relay_lasting_routes ORDER BY id"
    )
    return tuple(RelayRoute(**row) for row in rows)


def write_end(tx: Transaction, entry: RouteEnd) -> None:
    """Write that a route has ended, and an event of it; nothing of one that has ended already, or is removed."""
    ended = tx.change(
        "UPDATE routes SET ended_at = %s, end_code = %s WHERE id = %s AND ended_at IS NULL",
        (entry.ended_at, entry.code, entry.route_id),
    )
    if ended:
        target = {"target": entry.target} if is_app(entry.target) else {}
        details = {"route": entry.route_id, "source": entry.source, **target}
        robot = audited_robot(entry.source, entry.target)
        source = Source(entry.user)
        audit.record(
            tx, source, "route_ended", robot, entry.ended_at, **details, end_code=entry.code
        )
