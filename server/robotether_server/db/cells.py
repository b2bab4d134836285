"""The cells of the site, which are its machines, and which of them a robot connects to first.

Each relay writes its own cell's row and reads all; web and cli read them, and say which cell is drained.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime

from robotether_server import __version__
from robotether_server.db.database import Transaction, unique
from robotether_server.settings import CellSettings

# A relay writes its row each second.
ALIVE_S = 5


@dataclass(frozen=True)
class SshAddresses:
    """Where robots reach the sshd of a cell, the best port first."""

    host: str
    ports: tuple[int, ...]


@dataclass(frozen=True)
class Cell:
    """A machine of the site. `host` None: robots are not sent there. `robots`: how many are online there."""

    name: str
    host: str | None
    https_port: int
    ssh_ports: tuple[int, ...]
    peer_address: str | None
    version: str
    robots: int
    draining: bool
    is_alive: bool

    @property
    def ssh(self) -> SshAddresses | None:
        """Where robots that come now reach it; None: they are not sent there."""
        if self.host is None or self.draining or not self.is_alive:
            return None
        return SshAddresses(self.host, self.ssh_ports)


def read(tx: Transaction) -> list[Cell]:
    """Read all cells, by name."""
    rows = tx.rows(
        "SELECT name, host, https_port, ssh_ports, peer_address, version, robots, draining,"
        " heartbeat_at > CURRENT_TIMESTAMP(6) - INTERVAL %s SECOND AS is_alive"
        " FROM cells ORDER BY name",
        (ALIVE_S,),
    )
    return [
        Cell(
            **row
            | {
                "ssh_ports": tuple(int(port) for port in row["ssh_ports"].split(",")),
                "draining": bool(row["draining"]),
                "is_alive": bool(row["is_alive"]),
            }
        )
        for row in rows
    ]


def write_heartbeat(
    tx: Transaction, cell: CellSettings, *, robots: int, started_at: datetime
) -> None:
    """Write that a cell is alive; RecordExists while a relay that started later has its name."""
    values = {
        "name": cell.name,
        "host": cell.host,
        "https_port": cell.https_port,
        "ssh_ports": ",".join(map(str, cell.ssh_ports)),
        "peer_address": cell.peer_address,
        "version": __version__,
        "robots": robots,
        "started_at": started_at,
    }
    changes = ", ".join(f"{column} = %({column})s" for column in values if column != "name")
    known = tx.change(
        f"UPDATE cells SET {changes}, heartbeat_at = CURRENT_TIMESTAMP(6) WHERE name = %(name)s"  # noqa: S608 - the module's own text
        " AND (started_at <= %(started_at)s"
        f" OR heartbeat_at <= CURRENT_TIMESTAMP(6) - INTERVAL {ALIVE_S} SECOND)",
        values,
    )
    if known:
        return
    columns, placeholders = ", ".join(values), ", ".join(f"%({column})s" for column in values)
    with unique(
        f"cannot take part as cell {cell.name}: another relay has this name; "
        "give each machine a CELL of its own"
    ):
        tx.insert(f"INSERT INTO cells ({columns}) VALUES ({placeholders})", values)  # noqa: S608 - as above


def sort_for(robot_id: int, cells: Iterable[Cell], first: str | None = None) -> list[SshAddresses]:
    """Where a robot connects, the best first: the cell named `first`, then the others as the robot's id has it.

    That is the rendezvous order: a cell that goes moves its own robots alone, and spreads them over the others.
    """
    ranked = sorted(
        cells, key=lambda cell: (cell.name == first, _weight(robot_id, cell)), reverse=True
    )
    return [cell.ssh for cell in ranked if cell.ssh is not None]


def sort_for_join(robot_id: int, cells: Sequence[Cell]) -> list[SshAddresses]:
    """Where a robot that joins connects: first where the fewest robots are."""
    usable = [cell for cell in cells if cell.ssh is not None]
    if not usable:
        return []
    fewest = min(cell.robots for cell in usable)
    rivals = [cell for cell in usable if cell.robots == fewest]
    emptiest = max(rivals, key=lambda cell: _weight(robot_id, cell))
    return sort_for(robot_id, usable, emptiest.name)


def _weight(robot_id: int, cell: Cell) -> bytes:
    return hashlib.sha256(f"{robot_id}/{cell.name}".encode()).digest()
