"""Reads from the database what other cells wrote of robots' leases and stops, where the link to a cell cannot say it.

`wiring` makes one: each robot that begins a session here waits for it shortly, and it polls while a cell is away.
"""

from __future__ import annotations

import asyncio
import logging

from robotether_server.problems import StoreError
from robotether_server.relay.cells.cells import Cells
from robotether_server.relay.cells.peers import Peers
from robotether_server.relay.control.control import Control
from robotether_server.relay.records.database import RelayDatabase

log = logging.getLogger(__name__)

# Time limit for the read when a robot comes from another cell.
READ_WITHIN_S = 1.0
# Maximum number of reads at once: a whole fleet may come, and others ask the database, too.
MAX_READS = 8


class StoredControlReader:
    """Hands `control` what the database has of robots that were at other cells."""

    def __init__(
        self,
        database: RelayDatabase,
        control: Control,
        cells: Cells,
        peers: Peers,
        poll_every_s: float,
    ) -> None:
        self._database = database
        self._control = control
        self._cells = cells
        self._peers = peers
        self._poll_every_s = poll_every_s
        self._reads = asyncio.Semaphore(MAX_READS)

    async def read(self, robot_id: int) -> None:
        """Read what another cell wrote of a robot that begins a session here."""
        if not self._cells.peers():
            return
        try:
            async with asyncio.timeout(READ_WITHIN_S), self._reads:
                self._control.remember(await self._database.stored_control(robot_id))
        except (StoreError, TimeoutError):
            # Then it counts what other cells and the guard reported.
            log.info("robot %d: its stop and number could not be read", robot_id)
        except Exception:
            # Nor does any other answer of the database keep a robot out.
            log.exception("robot %d: its stop and number could not be read", robot_id)

    async def run(self) -> None:
        """Read all stops while a cell is not connected: a stop must not wait for the connection."""
        while True:
            await asyncio.sleep(self._poll_every_s)
            if self._peers.count() >= len(self._cells.peers()):
                continue
            try:
                self._control.remember(await self._database.stored_control())
            except StoreError:
                # `fleet` says in the log that the database is away.
                continue
            except Exception:
                log.exception("cannot read the stops of other cells; the next try may succeed")
