"""Who drives and which robots are stopped, as web shows it. Only the relay writes these tables (db/control.py)."""

from collections.abc import Mapping
from dataclasses import dataclass

from robotether_server.db.database import Row, Transaction
from robotether_server.field_types import Timestamp


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

DRIVERS = "SELECT robot_id, user_name AS user, since FROM control_leases WHERE ended_at IS NULL"
STOPS = "SELECT robot_id, by_name AS `by`, stopped_at AS at FROM robot_stops"


def of_robot(tx: Transaction, robot_id: int) -> ControlState:
    """Return the state of one robot."""
    lease = tx.row(f"{DRIVERS} AND robot_id = %s", (robot_id,))
    stop = tx.row(f"{STOPS} WHERE robot_id = %s", (robot_id,))
    return ControlState(_driver(lease) if lease else None, _stopped(stop) if stop else None)


def of_all(tx: Transaction) -> Mapping[int, ControlState]:
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
