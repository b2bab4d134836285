"""Writes robots' sessions and audit lines in the background, and keeps them while it cannot.

`observers` and `control` report to it and never wait. Entries that cannot be written are kept and tried again; the
queue is bounded, has a session once with its newest state, and logs when it has to drop one. Until they are written,
entries that people know of are also in the journal, in case the relay is killed.
"""

from __future__ import annotations

import asyncio
import logging
from collections import OrderedDict
from collections.abc import Callable, Sequence
from datetime import datetime

from robotether_server.audit_chain import LINES_LOST
from robotether_server.db.control import DriveEntry, StopEntry
from robotether_server.db.fleet import AuditEntry, Entry, FormerSessions, SessionEntry
from robotether_server.db.routes import RouteEnd
from robotether_server.problems import StoreError, StoreUnavailableError
from robotether_server.relay.records.database import RelayDatabase
from robotether_server.relay.records.journal import Journal, JournalEntry
from robotether_server.times import delays, utc_now

log = logging.getLogger(__name__)

MAX_WAITING = 10_000
BATCH = 100
# Time limit for the last events, of the 3 s that a stop takes in all.
WRITTEN_WITHIN_S = 0.7
# Author of the line that says how many lines of the audit log were lost.
RELAY = "relay"


class EventWriter:
    """A bounded queue of entries, and the task that writes them."""

    def __init__(
        self,
        database: RelayDatabase,
        max_waiting: int = MAX_WAITING,
        journal: Journal | None = None,
    ) -> None:
        self._database = database
        self._max_waiting = max_waiting
        self._journal = journal
        # None: what waits is in memory alone.
        self.folder = None if journal is None else journal.folder
        self._waiting: OrderedDict[int, Entry] = OrderedDict()
        # What the database is about to accept.
        self._writing: Sequence[Entry] = ()
        self._wake = asyncio.Event()
        self._idle = asyncio.Event()
        self._idle.set()
        self.dropped = 0
        # By robot: how many lines of the audit log were dropped, and when the first and the last of them happened.
        self._lost_lines: dict[str | None, tuple[int, datetime, datetime]] = {}
        # Is called with entries that the database has.
        self.on_written: Callable[[Sequence[Entry]], None] = lambda _: None

    def restore(self) -> tuple[list[StopEntry], list[RouteEnd]]:
        """Write what the relay before this one did not; return the stops and the ends of routes, to be taken over.

        Only `stops` can write the former. Before anything is added: what ends the drives and leases that it left open
        comes behind these.
        """
        former = [] if self._journal is None else self._journal.read()
        if former:
            log.warning("%d entries of the relay before this one wait", len(former))
        for entry in former:
            if not isinstance(entry, StopEntry):
                self._queue(entry)
        return (
            [entry for entry in former if isinstance(entry, StopEntry)],
            [entry for entry in former if isinstance(entry, RouteEnd)],
        )

    def add(self, entry: Entry) -> None:
        """Write the entry soon; adding a session again writes its newest state."""
        self._queue(entry)
        if self._journal is not None and isinstance(entry, JournalEntry):
            self._journal.add(entry)
            if self._journal.needs_rewrite(len(self._waiting) + len(self._writing)):
                # The new file lacks what was dropped before, and says so for the relay after one that is killed.
                entries = (*self._writing, *self._waiting.values(), *self._lost_entries())
                self._journal.rewrite(entry for entry in entries if isinstance(entry, JournalEntry))

    def waiting(self) -> int:
        """How many entries are not written yet."""
        return len(self._waiting)

    async def run(self) -> None:
        """Write for ever."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            await self._write_all()
            self._idle.set()

    async def flush(self, within_s: float = WRITTEN_WITHIN_S) -> None:
        """Wait until all is written, at most `within_s`."""
        try:
            async with asyncio.timeout(within_s):
                await self._idle.wait()
        except TimeoutError:
            log.warning("%d entries were not written to the database", len(self._waiting))

    def close(self) -> None:
        """Let the journal go."""
        if self._journal is not None:
            self._journal.close()

    def _queue(self, entry: Entry) -> None:
        self._waiting[id(entry)] = entry
        if len(self._waiting) > self._max_waiting:
            self._drop_oldest()
        self._idle.clear()
        self._wake.set()

    async def _write_all(self) -> None:
        pauses = delays()
        failing = False
        while self._waiting:
            batch = [
                self._waiting.popitem(last=False)[1] for _ in range(min(BATCH, len(self._waiting)))
            ]
            self._writing = batch
            try:
                await self._write(batch)
            except StoreUnavailableError as problem:
                self._put_back(batch)
                if not failing:
                    log.warning("%s; %d entries wait", problem.detail, len(self._waiting))
                failing = True
                await asyncio.sleep(next(pauses))
            else:
                if failing:
                    log.warning("the database accepts entries again")
                failing, pauses = False, delays()
                self._writing = ()
                self._add_lost_lines()
                if self._journal is not None and not self._waiting:
                    self._journal.clear()

    async def _write(self, batch: Sequence[Entry]) -> None:
        try:
            await self._write_together(batch)
        except StoreUnavailableError:
            raise
        except Exception:  # noqa: BLE001  # reported by `_write_alone`, for the entry that caused it
            # One entry that cannot be written must not keep the others from it; a stop may be among them.
            for entry in batch:
                await self._write_alone(entry)

    async def _write_together(self, batch: Sequence[Entry]) -> None:
        for position, row_id in (await self._database.write(batch)).items():
            entry = batch[position]
            if isinstance(entry, SessionEntry | DriveEntry):
                entry.row_id = row_id
        self.on_written(batch)

    async def _write_alone(self, entry: Entry) -> None:
        try:
            await self._write_together([entry])
        except StoreUnavailableError:
            self._queue(entry)
        except StoreError as problem:
            log.warning("cannot write %r: %s; dropped", entry, problem.detail)
            self._note_dropped(entry)
        except Exception:
            log.exception("cannot write %r; dropped", entry)
            self._note_dropped(entry)

    def _put_back(self, batch: Sequence[Entry]) -> None:
        for entry in reversed(batch):
            self._waiting[id(entry)] = entry
            self._waiting.move_to_end(id(entry), last=False)
        self._writing = ()

    def _drop_oldest(self) -> None:
        if self.dropped == 0:
            log.error("too many entries wait for the database; from now on the oldest are dropped")
        # A stop must outlive the relay, and a route's end; there is at most one entry a robot or route. And nobody
        # else ends what the relay before this one left open, which is the oldest entry, or says what that one lost.
        kinds = StopEntry | FormerSessions | RouteEnd
        oldest = (
            key
            for key, entry in self._waiting.items()
            if not isinstance(entry, kinds) and not _is_lost_lines(entry)
        )
        if (key := next(oldest, None)) is not None:
            self._note_dropped(self._waiting.pop(key))

    def _note_dropped(self, entry: Entry) -> None:
        self.dropped += 1
        if isinstance(entry, AuditEntry) and not _is_lost_lines(entry):
            count, first, last = self._lost_lines.get(entry.robot, (0, entry.at, entry.at))
            times = (first, last, entry.at)
            self._lost_lines[entry.robot] = count + 1, min(times), max(times)

    def _add_lost_lines(self) -> None:
        """Let the audit log say which of its lines it lacks."""
        entries = self._lost_entries()
        self._lost_lines = {}
        for entry in entries:
            self.add(entry)

    def _lost_entries(self) -> list[AuditEntry]:
        return [
            AuditEntry(
                utc_now(),
                RELAY,
                LINES_LOST,
                robot,
                details={"count": count, "since": first.isoformat(), "until": last.isoformat()},
            )
            for robot, (count, first, last) in self._lost_lines.items()
        ]


def _is_lost_lines(entry: Entry) -> bool:
    return isinstance(entry, AuditEntry) and entry.kind == LINES_LOST
