"""Who drives and which robots are stopped, as web shows it. Only the relay writes these tables (store/control.py)."""

from dataclasses import dataclass

from robotether_server.store.database import Transaction


@dataclass(frozen=True)
class ControlState:
    """Who drives a robot, and who stopped it; None: nobody."""

    driver: str | None = None
    stopped_by: str | None = None


def of_robot(tx: Transaction, robot_id: int) -> ControlState:
    """Return the state of one robot."""
    lease = tx.row(
        "SELECT user_name FROM control_leases WHERE robot_id = %s AND ended_at IS NULL", (robot_id,)
    )
    return ControlState(
        driver=lease["user_name"] if lease else None, stopped_by=stopped(tx).get(robot_id)
    )


def stopped(tx: Transaction) -> dict[int, str]:
    """Return the ids of the stopped robots, with who stopped each."""
    rows = tx.rows("SELECT robot_id, by_name FROM robot_stops")
    return {row["robot_id"]: row["by_name"] for row in rows}
