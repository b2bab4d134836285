"""How far each of the server's machines is, by the round trip, and which of them is clearly nearer.

`Connector` orders the list of cells by it, and a task of the session asks the server for a move. Measures beside the
tunnel, seldom, and never waits long for one cell.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable, Sequence
from random import Random
from time import monotonic
from typing import NoReturn

from robotether_agent.fields import ListedCell
from robotether_agent.net.server_dialer import ServerDialer
from robotether_agent.problems import AgentError
from robotether_agent.tasks import within

# Minimum gain, in both, for which a robot goes to another cell.
CLEAR_GAIN_S, CLEAR_GAIN = 0.02, 0.2
# Number of round trips of which the shortest counts, and time limit for all of one cell.
TRIPS = 3
MEASURED_WITHIN_S = 5.0
# Time after which a cell is measured again.
MEASURE_EVERY_S = 3600.0
# Interval before the first check of a session, and between checks: a fleet must not come all at once.
FIRST_AFTER_S = 2.0, 10.0
CHECK_EVERY_S = 240.0, 360.0

log = logging.getLogger(__name__)


def is_clearly_less(rtt_s: float, other_s: float) -> bool:
    """Return whether a round trip is clearly shorter than another one."""
    gain_s = other_s - rtt_s
    return gain_s >= CLEAR_GAIN_S and gain_s >= CLEAR_GAIN * other_s


class Distances:
    """The newest round trip to each cell, in seconds; none of a cell that did not answer."""

    def __init__(self, server_dialer: ServerDialer) -> None:
        self._server_dialer = server_dialer
        self._rng = Random()  # noqa: S311 - spreads a fleet, keeps no secret
        self._rtts_s: dict[ListedCell, float] = {}
        self._measured_at: dict[ListedCell, float] = {}

    def by_distance(self, cells: Iterable[ListedCell]) -> list[ListedCell]:
        """Return the cells as they are tried: by rank, and in a rank without those that are clearly farther first.

        Cells that are about equally near, and those of which nothing is known, stay in the server's order.
        """
        cells = list(cells)
        return sorted(cells, key=lambda cell: (cell.rank, self._excess_s(cell, cells)))

    def nearer(self, here: ListedCell, cells: Sequence[ListedCell]) -> ListedCell | None:
        """Return the nearest cell that is clearly nearer than `here` and of no worse rank, if there is one."""
        rank = next((cell.rank for cell in cells if cell == here), None)
        here_s = self._rtts_s.get(here)
        if rank is None or here_s is None:
            return None
        measured = [cell for cell in cells if cell.rank <= rank and cell in self._rtts_s]
        nearest = min(measured, key=lambda cell: self._rtts_s[cell])
        return nearest if is_clearly_less(self._rtts_s[nearest], here_s) else None

    async def measure(self, cells: Iterable[ListedCell]) -> None:
        """Measure the cells that were not measured within an hour."""
        for cell in cells:
            now = monotonic()
            if now - self._measured_at.get(cell, -MEASURE_EVERY_S) >= MEASURE_EVERY_S:
                self._measured_at[cell] = now
                await self._measure(cell)

    async def keep_asking(
        self,
        place: Callable[[], tuple[ListedCell | None, Sequence[ListedCell]]],
        ask: Callable[[ListedCell], None],
    ) -> NoReturn:
        """Measure the cells of a session, and ask for one that is clearly nearer; `place` is its cell, and the list."""
        await asyncio.sleep(self._rng.uniform(*FIRST_AFTER_S))
        while True:
            here, cells = place()
            if here is not None and len(cells) > 1:
                await self.measure(cells)
                nearer = self.nearer(here, cells)
                if nearer is not None:
                    log.info("asking for a move to %s, which is nearer", nearer.host)
                    ask(nearer)
            await asyncio.sleep(self._rng.uniform(*CHECK_EVERY_S))

    def _excess_s(self, cell: ListedCell, cells: Sequence[ListedCell]) -> float:
        """Return the round trip of a cell that is clearly farther than another of its rank, else 0."""
        equals = [self._rtts_s[c] for c in cells if c.rank == cell.rank and c in self._rtts_s]
        rtt_s = self._rtts_s.get(cell)
        is_far = rtt_s is not None and is_clearly_less(min(equals), rtt_s)
        return rtt_s if rtt_s is not None and is_far else 0.0

    async def _measure(self, cell: ListedCell) -> None:
        self._rtts_s.pop(cell, None)
        try:
            trips = self._server_dialer.round_trips_s(cell, TRIPS)
            self._rtts_s[cell] = min(await within(MEASURED_WITHIN_S, trips))
        except (AgentError, OSError, asyncio.TimeoutError) as error:
            log.debug("the distance of %s is not known: %r", cell.host, error)
