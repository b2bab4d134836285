"""The fleet as web and the command show it: presence, sessions, who drives, who stopped a robot.

Changes nothing: only the relay writes sessions (db/fleet.py), leases and stops (db/control.py).
"""

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass

from robotether_server.contract.offline import offline_reason
from robotether_server.db import cells, robots
from robotether_server.db.database import Row, Transaction
from robotether_server.db.grants import includes
from robotether_server.db.robots import RobotRow
from robotether_server.db.users import User
from robotether_server.identity import normalise_mac
from robotether_server.problems import GrantMissingError, RobotUnknownError
from robotether_server.schemas import Level, Timestamp


def _select(of_robot: str = "") -> str:
    # A session that lasts is a robot that is online. Of two cells' rows the one that ended may have been written last.
    sessions = (
        "SELECT s.robot_id, MAX(s.id) AS id FROM robot_sessions s "  # noqa: S608 - the modules' own text
        f"WHERE {cells.IS_PRESENT} {of_robot} GROUP BY s.robot_id"
    )
    return (
        f"SELECT {robots.COLUMNS}, "  # noqa: S608 - as above
        "present.id IS NOT NULL AS online, "
        "COALESCE(s.ended_at, IF(present.id IS NULL, lost.heartbeat_at, NULL), s.started_at) AS since, "
        "COALESCE(s.address, r.join_address) AS seen_address, "
        "COALESCE(s.agent_version, r.agent_version) AS seen_version, "
        f"o.state AS other_key, s.id IS NOT NULL AS ever_online, {cells.LOST_CODE} AS end_code, "
        "present.id IS NOT NULL AND COALESCE(s.ros_exposed, FALSE) AS ros_exposed, "
        "IF(%(admin)s, 'manage', g.level) AS level "
        "FROM robots r "
        f"LEFT JOIN ({sessions}) present ON present.robot_id = r.id "
        "LEFT JOIN robot_sessions s ON s.id = COALESCE("
        "present.id, (SELECT MAX(newest.id) FROM robot_sessions newest WHERE newest.robot_id = r.id)) "
        "LEFT JOIN other_keys o ON o.robot_id = r.id "
        "LEFT JOIN cells lost ON lost.name = s.cell "
        "LEFT JOIN (SELECT robot_id, level FROM relay_grants WHERE user_id = %(user_id)s) g "
        "ON g.robot_id = r.id "
        "WHERE (%(admin)s OR g.level IS NOT NULL) "
    )


SELECT_ALL = f"{_select()} ORDER BY r.name"
# MariaDB would find out for all robots which sessions last.
OF_ROBOT = "AND s.robot_id = (SELECT id FROM robots WHERE name = %(name)s)"
SELECT_ONE = f"{_select(OF_ROBOT)} AND r.name = %(name)s"
DRIVERS = (
    "SELECT s.robot_id, s.user_name AS user, s.since FROM control_leases s "  # noqa: S608 - as above
    f"WHERE s.ended_at IS NULL AND {cells.IS_OF_LIVE_CELL}"
)
STOPS = "SELECT robot_id, by_name AS `by`, stopped_at AS at FROM robot_stops"


@dataclass(frozen=True)
class SeenRobot:
    """A robot as one user sees it.

    `since`: the last change of `online`; None: never seen. `address` and `agent_version` are the newest
    session's, or else the join's. `ros_exposed`: everybody in the robot's own network reaches its rosbridge.
    """

    robot: RobotRow
    online: bool
    since: dt.datetime | None
    level: Level
    address: str | None = None
    agent_version: str | None = None
    ros_exposed: bool = False
    # Why it is offline; None: it is online.
    offline_reason: str | None = None


@dataclass(frozen=True)
class RecordedSession:
    """One session; `ended_at` is None while it lasts."""

    started_at: Timestamp
    ended_at: Timestamp | None
    end_code: str | None
    address: str
    agent_version: str | None


@dataclass(frozen=True)
class DrivenBy:
    """Who drives a robot, and since when."""

    user: str
    since: Timestamp


@dataclass(frozen=True)
class Stopped:
    """Who stopped a robot, and when."""

    by: str
    at: Timestamp


@dataclass(frozen=True)
class ControlState:
    """Who drives a robot, and who stopped it; None: nobody."""

    driver: DrivenBy | None = None
    stopped: Stopped | None = None


FREE = ControlState()


def _seen_robot(row: Row) -> SeenRobot:
    return SeenRobot(
        robot=robots.from_row(row),
        online=bool(row["online"]),
        since=row["since"],
        level=row["level"],
        address=row["seen_address"],
        agent_version=row["seen_version"],
        ros_exposed=bool(row["ros_exposed"]),
        offline_reason=None if row["online"] else _offline_reason(row),
    )


def _offline_reason(row: Row) -> str:
    return offline_reason(
        row["state"],
        row["end_code"],
        ever_online=bool(row["ever_online"]),
        other_key=row["other_key"],
        agent_version=row["seen_version"],
    )


def list_seen(tx: Transaction, user: User) -> list[SeenRobot]:
    """Return the robots that the user may see, by name; admins see all, as managers."""
    values = {"admin": user.is_admin, "user_id": user.id}
    return [_seen_robot(row) for row in tx.rows(SELECT_ALL, values)]


def find_seen(tx: Transaction, user: User, name: str) -> SeenRobot | None:
    """Return one robot, if there is one of that name that the user may see."""
    values = {"admin": user.is_admin, "user_id": user.id, "name": name}
    row = tx.row(SELECT_ONE, values)
    return _seen_robot(row) if row else None


def find_recorded(tx: Transaction, user: User, recording_id: int) -> SeenRobot | None:
    """Return the robot of a recording, whatever its name is now, if there still is one that the user may see."""
    row = tx.row(
        "SELECT r.name FROM recordings o JOIN robots r ON r.id = o.robot_id WHERE o.id = %s",
        (recording_id,),
    )
    return find_seen(tx, user, row["name"]) if row else None


def require(
    tx: Transaction, user: User, name: str, level: Level, to: str = "", *, mac: str | None = None
) -> SeenRobot:
    """Return a robot on which the user has that level, `to` do something; its name is the level if there is no other.

    `mac`: of the robot that is meant, as another one may have its name by now. Raises RobotUnknownError for one that is
    not meant or that the user may not see, or GrantMissingError.
    """
    seen = find_seen(tx, user, name)
    if seen is None:
        raise RobotUnknownError(
            f"cannot {to or level} robot {name}: there is none of that name that you may see"
        )
    if mac is not None and normalise_mac(mac) != seen.robot.mac:
        raise RobotUnknownError(
            f"cannot {to or level} robot {name}: another robot has this name now"
        )
    if not includes(seen.level, level):
        raise GrantMissingError(
            f"cannot {to or level} robot {name}: your grant is {seen.level}, and this needs {level}"
        )
    return seen


def list_all(tx: Transaction) -> list[SeenRobot]:
    """Return every robot, by name, as an admin sees it."""
    values = {"admin": True, "user_id": 0}
    return [_seen_robot(row) for row in tx.rows(SELECT_ALL, values)]


def count_seen(tx: Transaction) -> dict[int, int]:
    """Return how many robots each user may see, by the user's id; nothing for a user who sees none."""
    rows = tx.rows("SELECT user_id, COUNT(*) AS robots FROM relay_grants GROUP BY user_id")
    return {row["user_id"]: row["robots"] for row in rows}


def levels_of(tx: Transaction, user: User) -> frozenset[Level]:
    """Return the levels that the user has on any robot."""
    rows = tx.rows("SELECT DISTINCT level FROM relay_grants WHERE user_id = %s", (user.id,))
    return frozenset(row["level"] for row in rows)


def get_seen(tx: Transaction, name: str) -> SeenRobot:
    """Return one robot as an admin sees it; raise RecordMissingError."""
    values = {"admin": True, "user_id": 0, "name": name}
    row = tx.row(SELECT_ONE, values)
    if row is None:
        raise robots.missing(name)
    return _seen_robot(row)


def sessions_of(tx: Transaction, robot_id: int, limit: int) -> list[RecordedSession]:
    """Return a robot's sessions, the newest first, `limit` at most."""
    rows = tx.rows(
        f"SELECT s.started_at, IF({cells.IS_LOST}, "  # noqa: S608 - as above
        "(SELECT heartbeat_at FROM cells WHERE name = s.cell), s.ended_at) AS ended_at, "
        f"{cells.LOST_CODE} AS end_code, s.address, s.agent_version "
        "FROM robot_sessions s WHERE s.robot_id = %s ORDER BY s.id DESC LIMIT %s",
        (robot_id, limit),
    )
    return [RecordedSession(**row) for row in rows]


def is_online(tx: Transaction, robot_id: int) -> bool:
    """Return whether the robot has a session now."""
    row = tx.row(
        "SELECT s.id FROM robot_sessions s "  # noqa: S608 - as above
        f"WHERE s.robot_id = %s AND {cells.IS_PRESENT} LIMIT 1",
        (robot_id,),
    )
    return row is not None


def control_of(tx: Transaction, robot_id: int) -> ControlState:
    """Return the state of one robot."""
    lease = tx.row(f"{DRIVERS} AND robot_id = %s", (robot_id,))
    stop = tx.row(f"{STOPS} WHERE robot_id = %s", (robot_id,))
    return ControlState(_driver(lease) if lease else None, _stopped(stop) if stop else None)


def control_of_all(tx: Transaction) -> Mapping[int, ControlState]:
    """Return the states of all robots that somebody drives or has stopped, by their ids."""
    drivers = {row["robot_id"]: _driver(row) for row in tx.rows(DRIVERS)}
    stops = {row["robot_id"]: _stopped(row) for row in tx.rows(STOPS)}
    return {
        robot_id: ControlState(drivers.get(robot_id), stops.get(robot_id))
        for robot_id in drivers.keys() | stops.keys()
    }


def _driver(row: Row) -> DrivenBy:
    return DrivenBy(row["user"], row["since"])


def _stopped(row: Row) -> Stopped:
    return Stopped(row["by"], row["at"])
