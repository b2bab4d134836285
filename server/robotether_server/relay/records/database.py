"""The relay's access to the database: queries from the event loop, run on threads.

`fleet`, `credentials` and `event_writer` ask here. Nothing on the way of a message does. A database that
hangs must not take the loop's shared threads, where names are resolved for new connections.
"""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import datetime
from typing import TypeVar

from robotether_server.audit_chain import ChainEnd, SignedHead
from robotether_server.db import Database, Transaction, audit_chains, cells, control, fleet
from robotether_server.db.cells import Cell, CellCounts
from robotether_server.db.control import NewLease, StoredControl
from robotether_server.db.fleet import Changes, Credential, Entry, RelayRequest, RelayUser, Snapshot
from robotether_server.problems import StoreError, StoreUnavailableError
from robotether_server.settings.server import CellSettings, RelaySettings

T = TypeVar("T")

log = logging.getLogger(__name__)

THREADS = 4
# Maximum number of open questions; one that waits behind them would be answered too late.
MAX_OPEN_QUESTIONS = 64
# Number of idle connections; the database's accounts have few for all cells.
KEPT_CONNECTIONS = 2
# Time limit for questions about taking control, which works without an answer.
BRIEF_S = 1.0
# Interval between questions for the number of connections.
COUNT_EVERY_S = 10.0


@dataclass(frozen=True)
class ConnectionCount:
    """Connections to the database that are open, and the maximum."""

    used: int
    limit: int


class RelayDatabase:
    """What the relay of a cell asks the database; StoreUnavailableError when it does not answer."""

    # When the database last accepted something, by the monotonic clock; None: not since the start.
    written_at_s: float | None = None
    # Those of everybody and of this account; None: unknown.
    connections: Mapping[str, ConnectionCount] | None = None

    def __init__(self, database: Database, cell: str, answer_within_s: float = 3.0) -> None:
        self._database = database
        self._cell = cell
        self._answer_within_s = answer_within_s
        self._threads = ThreadPoolExecutor(THREADS, thread_name_prefix="records")
        self._open = 0
        # Whether the last question that was asked got no answer in time.
        self._hangs = False

    async def changes(self) -> Changes:
        """Return whether anything changed."""
        return await self._ask(fleet.changes)

    async def load(self) -> Snapshot:
        """Read robots and rights."""
        return await self._ask(fleet.load)

    async def help_requests(self) -> list[RelayRequest]:
        """Read robots' open requests for help."""
        return await self._ask(fleet.read_requests)

    async def last_seen(self) -> list[tuple[int, datetime, str | None]]:
        """Read since when and why robots are offline."""
        return await self._ask(fleet.last_seen)

    async def users_of(
        self, credentials: Collection[Credential], *, briefly: bool = False
    ) -> dict[Credential, RelayUser]:
        """Read who credentials belong to; `briefly`: for somebody who waits to drive.

        Not while the database hangs: another cell then serves a person who stops a robot, if it knows the person.
        """
        self._check_answers()
        return await self._ask(lambda tx: fleet.users_of(tx, credentials), briefly=briefly)

    async def stored_control(self, robot_id: int | None = None) -> StoredControl:
        """Read the newest numbers of drives, and which robots are stopped; of all robots, or of one."""
        return await self._ask(lambda tx: control.read_stored(tx, robot_id))

    async def next_fence(self, lease: NewLease) -> int:
        """Number a drive; the number is committed. One that comes too late is not."""
        return await self._ask(lambda tx: control.next_fence(tx, lease, self._cell), briefly=True)

    async def heartbeat(
        self, cell: CellSettings, counts: CellCounts, started_at: datetime
    ) -> list[Cell]:
        """Write that this cell is alive, and what it counts; return all cells."""

        def exchange(tx: Transaction) -> list[Cell]:
            cells.write_heartbeat(tx, cell, counts, started_at)
            return cells.read(tx)

        others = await self._ask(exchange)
        self.written_at_s = time.monotonic()
        return others

    async def write(self, entries: Sequence[Entry]) -> dict[int, int]:
        """Write entries in one transaction; return new rows' ids by the entry's place."""
        # Not cut short: a write that goes on in its thread and is tried again would be there twice.
        rows = await self._in_thread(lambda tx: fleet.write(tx, entries, self._cell))
        self.written_at_s = time.monotonic()
        return rows

    async def count_connections(self) -> None:
        """Count for ever how many connections there are."""
        while True:
            try:
                self.connections = await self._ask(_read_connections)
            except StoreError:
                self.connections = None
            except Exception:
                log.exception("cannot count the database's connections")
                self.connections = None
            await asyncio.sleep(COUNT_EVERY_S)

    async def sign_newest(
        self, chain: str, sign: Callable[[ChainEnd], SignedHead]
    ) -> tuple[ChainEnd, str | None] | None:
        """Sign the newest line of a chain of the audit log; return what its robot is to sign, if anything."""
        return await self._ask(lambda tx: audit_chains.sign_newest(tx, chain, sign))

    async def add_robots_head(self, head: SignedHead) -> bool:
        """Write what a robot signed; return whether the server has signed the same line."""
        return await self._ask(lambda tx: audit_chains.add_robots_head(tx, head))

    async def chains_to_sign(self) -> list[str]:
        """Read which chains of the audit log were last signed a day ago, and are longer now."""
        return await self._ask(audit_chains.chains_to_sign)

    def close(self) -> None:
        """Let the threads go; does not wait for a database that hangs."""
        self._threads.shutdown(wait=False, cancel_futures=True)

    async def _ask(self, question: Callable[[Transaction], T], *, briefly: bool = False) -> T:
        """Ask, at most for the time that is set; `briefly`: for a second, and not while the database hangs."""
        within_s = min(BRIEF_S, self._answer_within_s) if briefly else self._answer_within_s
        if briefly:
            self._check_answers()
        is_over = threading.Event()

        def answer_in_time(tx: Transaction) -> T:
            result = question(tx)
            if is_over.is_set():
                # Nobody would know of what it wrote.
                raise StoreUnavailableError("cannot reach the database: its answer came too late")
            return result

        try:
            async with asyncio.timeout(within_s):
                result = await self._in_thread(answer_in_time)
        except TimeoutError as exc:
            self._hangs = True
            self._database.close_kept()
            raise StoreUnavailableError(
                f"cannot reach the database: no answer in {within_s:g} s; try again shortly"
            ) from exc
        finally:
            is_over.set()
        self._hangs = False
        return result

    def _check_answers(self) -> None:
        if self._hangs:
            raise StoreUnavailableError("cannot reach the database: it hangs; try again shortly")

    async def _in_thread(self, question: Callable[[Transaction], T]) -> T:
        if self._open >= MAX_OPEN_QUESTIONS:
            raise StoreUnavailableError("cannot reach the database: too many queries are waiting")
        self._open += 1
        future = asyncio.get_running_loop().run_in_executor(
            self._threads, self._database.run, question
        )
        future.add_done_callback(self._answered)
        return await asyncio.shield(future)

    def _answered(self, future: asyncio.Future[T]) -> None:
        self._open -= 1
        if not future.cancelled():
            # Whoever asked may have stopped waiting; its problem has then been reported already.
            future.exception()


def _read_connections(tx: Transaction) -> dict[str, ConnectionCount]:
    everybody = tx.row("SHOW GLOBAL STATUS LIKE 'Threads_connected'") or {}
    # Of others' connections the account sees none.
    row = (
        tx.row(
            """SELECT @@max_connections AS most, @@max_user_connections AS most_of_account,
        (SELECT COUNT(*) FROM information_schema.processlist
         WHERE user = SUBSTRING_INDEX(CURRENT_USER(), '@', 1)) AS own"""
        )
        or {}
    )
    return {
        "everybody": ConnectionCount(int(everybody["Value"]), row["most"]),
        "relay": ConnectionCount(row["own"], row["most_of_account"]),
    }


def open_database(settings: RelaySettings) -> RelayDatabase:
    """Return the database of these settings, to which nothing connects yet."""
    return RelayDatabase(Database(settings.database, keep=KEPT_CONNECTIONS), settings.cell.name)
