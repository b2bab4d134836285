"""The cells of the site, which are its machines, and which of them a robot connects to first.

Each relay writes its own cell's row and reads all; web and cli read them, and say which cell is drained.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime

from robotether_server import __version__
from robotether_server.db.database import Row, Transaction, unique
from robotether_server.problems import RecordMissingError
from robotether_server.settings.server import CellSettings
from robotether_server.times import MAX_TICKET_AHEAD_S, MAX_TICKET_TTL_S, utc_now

# Maximum age of a living cell's row; its relay writes it each second.
ALIVE_S = 5
# Maximum age of what a cell's recorder counted; it writes that each 10 s.
RECORDER_CURRENT_S = 60


@dataclass(frozen=True)
class SshAddresses:
    """Where robots reach the sshd of a cell, the best port first.

    Of cells with one `rank` a robot chooses the nearest; else the lower one comes first.
    """

    host: str
    ports: tuple[int, ...]
    rank: int = 0


@dataclass(frozen=True)
class Cell:
    """A machine of the site. `host` None: robots are not sent there. `robots`: how many are online there.

    `clock_ahead_s`: how far its clock is ahead of the database's, in seconds; None: unknown, or its tickets expired.
    `disk_free`: part of the disk with the relay's volume that is free, from 0 to 1; `recordings_free`: of the room for
    recordings, of their disk or RECORDINGS_MAX_GB; `recorders`: how many are connected there; None: unknown.
    """

    name: str
    host: str | None
    https_port: int
    ssh_ports: tuple[int, ...]
    peer_address: str | None
    version: str
    robots: int
    draining: bool
    is_alive: bool
    region: str | None = None
    clock_ahead_s: float | None = None
    disk_free: float | None = None
    recorders: int | None = None
    recordings_free: float | None = None

    @property
    def is_listed(self) -> bool:
        """Whether robots are sent there while there is a choice."""
        return self.host is not None and self.is_alive and not self.draining


@dataclass(frozen=True)
class CellCounts:
    """What a relay says of its cell with each heartbeat, as in `Cell`."""

    robots: int = 0
    disk_free: float | None = None
    recorders: int | None = None


def is_current(column: str, seconds: int) -> str:
    """Return the condition that a time is no older; one of the future was written before the clock was set back."""
    age = f"INTERVAL {seconds} SECOND"
    return f"({column} BETWEEN CURRENT_TIMESTAMP(6) - {age} AND CURRENT_TIMESTAMP(6) + {age})"


CLOCK_AHEAD_S = "TIMESTAMPDIFF(MICROSECOND, CURRENT_TIMESTAMP(6), %(now)s) / 1000000"
# The tickets that a dead cell signed are good for a while.
MAY_HAVE_TICKETS = f"c.heartbeat_at > CURRENT_TIMESTAMP(6) - INTERVAL {MAX_TICKET_TTL_S + MAX_TICKET_AHEAD_S} SECOND"
IS_ALIVE = is_current("c.heartbeat_at", ALIVE_S)
# Of a row `s` of sessions or leases. What a dead cell left open is over, though nobody could write that.
IS_OF_LIVE_CELL = (
    f"(s.cell IS NULL OR EXISTS (SELECT 1 FROM cells c WHERE c.name = s.cell AND {IS_ALIVE}))"  # noqa: S608 - the module's own text
)
# Of a row `s` of sessions or drives: its cell is dead, and nobody has ended it. It shows as what `remove` would write.
IS_LOST = f"(s.ended_at IS NULL AND NOT {IS_OF_LIVE_CELL})"
LOST_CODE = f"IF({IS_LOST}, 'cell_removed', s.end_code)"
# Of a row `s` of robot_sessions: it is the newest of its cell, and lasts. NOT EXISTS would read the whole table.
IS_PRESENT = (
    f"s.ended_at IS NULL AND {IS_OF_LIVE_CELL} AND s.id = (SELECT newest.id FROM robot_sessions newest"  # noqa: S608 - as above
    " WHERE newest.robot_id = s.robot_id AND newest.cell <=> s.cell ORDER BY newest.id DESC LIMIT 1)"
)
# An older relay writes the row, and leaves what it does not count as it was.
IS_COUNTED = f"({IS_ALIVE} AND c.counted_at = c.heartbeat_at)"
IS_RECORDERS_COUNT_CURRENT = is_current("c.recordings_counted_at", RECORDER_CURRENT_S)
SELECT = (
    "SELECT c.name, c.host, c.https_port, c.ssh_ports, c.peer_address, c.version, c.robots, c.draining,"  # noqa: S608 - as above
    f" c.region, IF({MAY_HAVE_TICKETS}, c.clock_ahead_s, NULL) AS clock_ahead_s, {IS_ALIVE} AS is_alive,"
    f" IF({IS_COUNTED}, c.disk_free, NULL) AS disk_free, IF({IS_COUNTED}, c.recorders, NULL) AS recorders,"
    f" IF({IS_RECORDERS_COUNT_CURRENT}, c.recordings_free, NULL) AS recordings_free FROM cells c "
)


def read(tx: Transaction) -> list[Cell]:
    """Read all cells, by name."""
    return [_cell_of(row) for row in tx.rows(SELECT + "ORDER BY c.name")]


def list_regions(tx: Transaction) -> list[str]:
    """Return the regions of the cells, by name; none where no cell says its own."""
    return sorted({cell.region for cell in read(tx) if cell.region is not None})


def get(tx: Transaction, name: str) -> Cell:
    """Return the cell of that name; raise RecordMissingError."""
    row = tx.row(SELECT + "WHERE c.name = %s", (name,))
    if row is None:
        raise RecordMissingError(f"cannot find cell {name}: no such cell; see: cell list")
    return _cell_of(row)


def lock_drains(tx: Transaction) -> None:
    """Make drains take turns: each waits here until the one before it is committed."""
    # One row is enough for that, and no other cell's heartbeat waits for it.
    tx.rows("SELECT name FROM cells ORDER BY name LIMIT 1 FOR UPDATE")


def set_draining(tx: Transaction, name: str, *, on: bool) -> None:
    """Write whether a cell is taken out of service."""
    tx.change("UPDATE cells SET draining = %s WHERE name = %s", (on, name))


def remove(tx: Transaction, name: str) -> None:
    """Remove a cell, and end what its relay left open."""
    tx.change("CALL remove_cell(%s)", (name,))


def find_of_robot(tx: Transaction, robot_id: int) -> Cell | None:
    """Return the cell where a robot is online."""
    row = tx.row(
        f"{SELECT} JOIN robot_sessions s ON s.cell = c.name"
        f" WHERE s.robot_id = %s AND {IS_PRESENT} ORDER BY s.id DESC LIMIT 1",
        (robot_id,),
    )
    return None if row is None else _cell_of(row)


def names_by_robot(tx: Transaction) -> dict[int, str | None]:
    """Return the name of the cell where each robot is online, by the robot's id; None: that of a site with one."""
    rows = tx.rows(
        f"SELECT s.robot_id, s.cell FROM robot_sessions s WHERE {IS_PRESENT} ORDER BY s.id"  # noqa: S608 - the module's own text
    )
    return {row["robot_id"]: row["cell"] for row in rows}


def _cell_of(row: Row) -> Cell:
    ports = tuple(int(port) for port in row["ssh_ports"].split(","))
    # MariaDB has no truth values of its own.
    flags = {name: bool(row[name]) for name in ("draining", "is_alive")}
    # A machine that is down has lost its robots, and nobody could write that.
    robots = row["robots"] if row["is_alive"] else 0
    return Cell(**row | flags | {"ssh_ports": ports, "robots": robots})


def write_heartbeat(
    tx: Transaction, cell: CellSettings, counts: CellCounts, started_at: datetime
) -> None:
    """Write that a cell is alive; RecordExistsError while a relay that started later has its name."""
    values = {
        "name": cell.name,
        "host": cell.host,
        "https_port": cell.https_port,
        "ssh_ports": ",".join(map(str, cell.ssh_ports)),
        "peer_address": cell.peer_address,
        "region": cell.region,
        "version": __version__,
        "started_at": started_at,
        **asdict(counts),
    }
    changes = ", ".join(f"{column} = %({column})s" for column in values if column != "name")
    row_count = tx.change(
        f"UPDATE cells c SET {changes}, clock_ahead_s = {CLOCK_AHEAD_S},"  # noqa: S608 - the module's own text
        " heartbeat_at = CURRENT_TIMESTAMP(6), counted_at = CURRENT_TIMESTAMP(6) WHERE name = %(name)s"
        f" AND (started_at <= %(started_at)s OR NOT {IS_ALIVE})",
        values | {"now": utc_now()},
    )
    if row_count:
        return
    columns, placeholders = ", ".join(values), ", ".join(f"%({column})s" for column in values)
    with unique(
        f"cannot take part as cell {cell.name}: another relay has this name; "
        "give each machine a CELL of its own"
    ):
        tx.insert(
            f"INSERT INTO cells ({columns}, heartbeat_at, counted_at)"  # noqa: S608 - as above
            f" VALUES ({placeholders}, CURRENT_TIMESTAMP(6), CURRENT_TIMESTAMP(6))",
            values,
        )


def write_recordings_free(tx: Transaction, name: str, free: float) -> None:
    """Write which part of the disk with a cell's recordings is free, from 0 to 1, as its recorder."""
    tx.change(
        "UPDATE cells SET recordings_free = %s, recordings_counted_at = CURRENT_TIMESTAMP(6) WHERE name = %s",
        (free, name),
    )


def sort_for(
    robot_id: int,
    cells: Iterable[Cell],
    first: str | None = None,
    *,
    second: str | None = None,
    region: str | None = None,
    is_sent: bool = False,
) -> list[SshAddresses]:
    """Where a robot connects, the best first: `first`, `second`, then the others as the robot's id has it.

    A robot that `is_sent` goes to `first` however far that is.

    That is the rendezvous order: a cell that goes moves its own robots alone, and spreads them over the others. The
    cells of the robot's region come before all others, in the same order. Those that are drained come last: the others
    may all die.
    """

    def group(cell: Cell) -> tuple[bool, ...]:
        return not cell.draining, _is_in(cell, region), is_sent and cell.name == first

    ranked = sorted(
        (cell for cell in cells if cell.is_alive),
        key=lambda cell: (
            *group(cell),
            cell.name == first,
            cell.name == second,
            _weight(robot_id, cell),
        ),
        reverse=True,
    )
    addressed = [(cell.host, cell) for cell in ranked if cell.host is not None]
    groups = list(dict.fromkeys(group(cell) for _, cell in addressed))
    return [
        SshAddresses(host, cell.ssh_ports, groups.index(group(cell))) for host, cell in addressed
    ]


def sort_for_join(
    robot_id: int, cells: Sequence[Cell], *, region: str | None = None
) -> list[SshAddresses]:
    """Where a robot that joins connects: first where the fewest robots are, of its region's cells if there are any."""
    first = max(
        _near(cells, region),
        key=lambda cell: (-cell.robots, _weight(robot_id, cell)),
        default=None,
    )
    return sort_for(robot_id, cells, first.name if first else None, region=region)


def find_emptiest(cells: Iterable[Cell], *, region: str | None) -> Cell | None:
    """Return the cell with the fewest robots of those that take robots: of the region's if there are any."""
    return min(_near(cells, region), key=lambda cell: cell.robots, default=None)


def find_choice(
    cells: Iterable[Cell], address: SshAddresses, here: str, *, region: str | None
) -> Cell | None:
    """Return the cell at an address, if a robot at the cell `here` may choose it."""
    by_name = {cell.name: cell for cell in cells}
    own = by_name.get(here)
    for cell in by_name.values():
        is_there = (cell.host, cell.ssh_ports) == (address.host, address.ports)
        if is_there and cell.is_listed and cell != own:
            return cell if own is None or _is_in(cell, region) >= _is_in(own, region) else None
    return None


def _near(cells: Iterable[Cell], region: str | None) -> list[Cell]:
    listed = [cell for cell in cells if cell.is_listed]
    return [cell for cell in listed if _is_in(cell, region)] or listed


def _is_in(cell: Cell, region: str | None) -> bool:
    return region is not None and cell.region == region


def _weight(robot_id: int, cell: Cell) -> bytes:
    return hashlib.sha256(f"{robot_id}/{cell.name}".encode()).digest()
