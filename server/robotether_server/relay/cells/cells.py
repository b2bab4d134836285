"""This relay's cell and the others of the site: writes its own heartbeat and reads all cells, each second.

`wiring` runs it. While the database is away all stays as it was last read.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from robotether_server.db import cells
from robotether_server.db.cells import ALIVE_S, Cell, CellCounts, SshAddresses
from robotether_server.disks import DiskSpace, read_space
from robotether_server.problems import StoreError, StoreUnavailableError
from robotether_server.relay.records.database import RelayDatabase
from robotether_server.settings.server import CellSettings
from robotether_server.times import utc_now

log = logging.getLogger(__name__)

POLL_EVERY_S = 1.0
# Maximum age of the other cells' numbers of robots.
CURRENT_S = 3.0
# Difference up to which clocks count as equal: the way to the database takes part of it.
CLOCKS_AGREE_S = 0.5
# Interval between two looks at the disk, and the maximum age of what it said: a disk may hang.
DISK_EVERY_S = 10.0
DISK_CURRENT_S = 30.0


class Cells:
    """What is known of the site's cells; listeners are notified when anything but the number of robots changes."""

    def __init__(
        self,
        settings: CellSettings,
        database: RelayDatabase,
        robots: Callable[[], int],
        region_of: Callable[[int], str | None] = lambda _: None,
        poll_every_s: float = POLL_EVERY_S,
    ) -> None:
        self._settings = settings
        self.name = settings.name
        # Whether this cell has an address for the others.
        self.is_reachable = settings.peer_address is not None
        self._database = database
        self._robots = robots
        self._region_of = region_of
        self._poll_every_s = poll_every_s
        self._started_at = utc_now()
        self._listeners: list[Callable[[], None]] = []
        self._cells: Mapping[str, Cell] = {}
        self._problem: str | None = None
        self._settled_at = self._read_at = 0.0
        # Counts the recorders that are connected, for each heartbeat.
        self.count_recorders: Callable[[], int] | None = None
        # When it was read, and what it said.
        self._disk: tuple[float, DiskSpace] | None = None

    async def watch_disk(self, folder: Path | None) -> None:
        """Say with each heartbeat how full the file system of the folder is, for ever; nothing without a folder."""
        while folder is not None:
            try:
                space = await asyncio.to_thread(read_space, folder)
            except OSError as problem:
                log.warning("cannot see how full %s is: %s", folder, problem)
            else:
                self._disk = asyncio.get_running_loop().time(), space
            await asyncio.sleep(DISK_EVERY_S)

    @property
    def draining(self) -> bool:
        """Whether this cell is taken out of service."""
        own_cell = self._cells.get(self.name)
        return own_cell is not None and own_cell.draining

    @property
    def disk(self) -> DiskSpace | None:
        """How full the watched disk is; None: unknown."""
        if self._disk is None:
            return None
        read_at, space = self._disk
        return space if asyncio.get_running_loop().time() - read_at <= DISK_CURRENT_S else None

    @property
    def recordings_free(self) -> float | None:
        """Part of the room for this cell's recordings that is free, as its recorder wrote; None: unknown."""
        own_cell, now = self._cells.get(self.name), asyncio.get_running_loop().time()
        is_current = now - self._read_at <= DISK_CURRENT_S
        return own_cell.recordings_free if own_cell is not None and is_current else None

    def peers(self) -> list[Cell]:
        """The other cells that can be reached, alive or not."""
        cells_elsewhere = (cell for cell in self._cells.values() if cell.name != self.name)
        return [cell for cell in cells_elsewhere if cell.peer_address is not None]

    def clocks_ahead_s(self) -> float:
        """Return how far another cell's clock is ahead of this one's, at most; 0 while that is not worth a wait."""
        own_cell = self._cells.get(self.name)
        if own_cell is None or own_cell.clock_ahead_s is None:
            return 0.0
        ahead = [cell.clock_ahead_s for cell in self._cells.values() if cell.clock_ahead_s]
        ahead_s = max(ahead, default=0.0) - own_cell.clock_ahead_s
        return ahead_s if ahead_s >= CLOCKS_AGREE_S else 0.0

    def addresses(self, robot_id: int, first: str | None = None) -> list[SshAddresses]:
        """Where a robot of this cell connects, the best first: here, unless its region is another; last if this drains.

        With `first`, at the cell of that name, or here if it cannot reach that one.
        """
        region = self._region_of(robot_id)
        return cells.sort_for(
            robot_id,
            self._cells.values(),
            first or self.name,
            second=self.name,
            region=region,
            is_sent=first is not None,
        )

    def robots_leave(self) -> bool:
        """Whether robots go from here to others: this cell is drained, and another one takes them."""
        return self.draining and any(cell.is_listed for cell in self._cells.values())

    def surplus(self, robot_id: int | None = None) -> tuple[int, str]:
        """Return how many robots this cell has more than the emptiest that takes robots, and that one's name.

        With `robot_id`, than the emptiest of the robot's region, if there is one. 0 while this is not known.
        """
        region = None if robot_id is None else self._region_of(robot_id)
        emptiest = cells.find_emptiest(self._cells.values(), region=region)
        if emptiest is None or emptiest.name == self.name or not self._is_current:
            return 0, self.name
        return self._robots() - emptiest.robots, emptiest.name

    def choice(self, robot_id: int, address: SshAddresses) -> tuple[Cell, int] | None:
        """Return the cell at an address, if a robot of this cell may choose it, and how many more robots it has.

        More than the emptiest that takes this robot. None also while this is not known.
        """
        region, site_cells = self._region_of(robot_id), self._cells.values()
        cell = cells.find_choice(site_cells, address, self.name, region=region)
        emptiest = cells.find_emptiest(site_cells, region=region)
        if cell is None or emptiest is None or not self._is_current:
            return None
        return cell, cell.robots - emptiest.robots

    @property
    def _is_current(self) -> bool:
        now = asyncio.get_running_loop().time()
        return now >= self._settled_at and now - self._read_at < CURRENT_S

    def listen(self, listener: Callable[[], None]) -> None:
        """Notify this of changes from now on."""
        self._listeners.append(listener)

    async def run(self) -> None:
        """Poll for ever."""
        while True:
            await self.poll()
            await asyncio.sleep(self._poll_every_s)

    async def poll(self) -> None:
        """Write the heartbeat, and read all cells."""
        try:
            site_cells = await self._database.heartbeat(
                self._settings, self._counts(), self._started_at
            )
        except StoreUnavailableError:
            # `fleet` says in the log that the database is away.
            self._settled_at = asyncio.get_running_loop().time() + ALIVE_S
        except StoreError as problem:
            self._report(problem.detail)
        except Exception:
            log.exception("cannot write this cell's heartbeat; cells stay as they were last read")
        else:
            self._report(None)
            self._update({cell.name: cell for cell in site_cells})

    def _counts(self) -> CellCounts:
        free = None if self.disk is None else self.disk.free_part
        return CellCounts(
            self._robots(), free, self.count_recorders() if self.count_recorders else None
        )

    def _update(self, site_cells: Mapping[str, Cell]) -> None:
        self._read_at = asyncio.get_running_loop().time()
        if self._read_at < self._settled_at:
            # The others could not write either, while the database was away.
            site_cells = {name: self._still_alive(cell) for name, cell in site_cells.items()}
        before, self._cells = self._cells, site_cells
        if _without_counts(before) != _without_counts(site_cells):
            for listener in self._listeners:
                listener()

    def _still_alive(self, cell: Cell) -> Cell:
        before = self._cells.get(cell.name)
        return replace(cell, is_alive=cell.is_alive or (before is not None and before.is_alive))

    def _report(self, problem: str | None) -> None:
        if problem is not None and problem != self._problem:
            log.error("%s", problem)
        self._problem = problem


def _without_counts(site_cells: Mapping[str, Cell]) -> list[Cell]:
    counts = ("clock_ahead_s", "disk_free", "recorders", "recordings_free")
    nothing = dict.fromkeys(counts)
    return [replace(cell, robots=0, **nothing) for cell in site_cells.values()]  # type: ignore[arg-type] # as in Cell
