"""What the recorder reads and writes in the database, from the event loop.

A recording goes on while the database is away: what is to be written of its end waits here.
"""

from __future__ import annotations

import asyncio
import datetime as dt
import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from robotether_server.db import Database, Transaction, audit, cells, recordings
from robotether_server.db.audit import Source
from robotether_server.db.fleet import RECORDER
from robotether_server.db.recordings import (
    Progress,
    RecordableRobot,
    RecordingCause,
    RecordingRow,
)
from robotether_server.problems import StoreError
from robotether_server.times import utc_now

log = logging.getLogger(__name__)

T = TypeVar("T")
# Ends of which the person who asked for the recording knows nothing: it goes on in another.
CONTINUED_ENDS = frozenset(
    ("robot_moved", "robot_renamed", "recorder_stopped", "recorder_restarted")
)


@dataclass(frozen=True)
class RecordingEnd:
    """The end of a recording; `progress` None: nothing of it is known beyond what was written."""

    id: int
    robot: str
    actor: str
    code: str
    progress: Progress | None
    ended_at: dt.datetime


class RecorderStore:
    """The recordings of one cell."""

    def __init__(self, database: Database, cell: str) -> None:
        self._database = database
        self._cell = cell
        # Not yet written.
        self._ends: list[RecordingEnd] = []
        self.is_up = False

    async def read(self) -> tuple[list[RecordingRow], list[RecordableRobot]] | None:
        """Read what there is to do; None while the database is away."""
        ends = list(self._ends)

        def read(tx: Transaction) -> tuple[list[RecordingRow], list[RecordableRobot]]:
            for recording_end in ends:
                self._write(tx, recording_end)
            return recordings.read_open(tx, self._cell), recordings.read_robots(tx)

        answer = await self._ask(read)
        if answer is not None:
            # Only now they are committed.
            del self._ends[: len(ends)]
        return answer

    async def begin(self, row: RecordingRow, robot: RecordableRobot) -> bool:
        """Begin what somebody asked for; return whether it is this cell's to record."""

        def begin(tx: Transaction) -> bool:
            # As its end, by the clock of its file.
            if not recordings.begin(tx, row.id, self._cell, utc_now()):
                return False
            source = Source(row.asked_by or RECORDER.name)
            audit.record(tx, source, "recording_started", robot.name, recording=row.id)
            return True

        return bool(await self._ask(begin))

    async def add(
        self, robot: RecordableRobot, cause: RecordingCause, started_at: dt.datetime
    ) -> int | None:
        """Begin a recording by the robot's settings; return its number, None while the database is away."""

        def add(tx: Transaction) -> int:
            number = recordings.add(tx, robot, cause, self._cell, started_at)
            source = Source(RECORDER.name)
            audit.record(tx, source, "recording_started", robot.name, recording=number)
            return number

        return await self._ask(add)

    async def write_progress(self, progress: dict[int, Progress]) -> None:
        """Write how far recordings are."""

        def write(tx: Transaction) -> None:
            for recording_id, reached in progress.items():
                recordings.write_progress(tx, recording_id, reached)

        if progress:
            await self._ask(write)

    async def write_room(self, free_part: float) -> None:
        """Write which part of the room for recordings is free."""
        await self._ask(lambda tx: cells.write_recordings_free(tx, self._cell, free_part))

    async def read_bytes_elsewhere(self, before: int) -> int:
        """Read what the recordings of the site's other cells take; `before` while the database is away."""
        size = await self._ask(lambda tx: recordings.read_bytes_elsewhere(tx, self._cell))
        return before if size is None else size

    def end(self, recording_end: RecordingEnd) -> None:
        """Have the end of a recording written with the next reading."""
        self._ends.append(recording_end)

    async def note_deleted(self, recording_id: int) -> None:
        """Write that a file is gone."""
        await self._ask(lambda tx: recordings.note_deleted(tx, recording_id))

    async def read_older(self, before: dt.datetime) -> list[int]:
        """Read which recordings are kept for long enough."""
        return await self._ask(lambda tx: recordings.read_older(tx, self._cell, before)) or []

    async def read_present(self, recording_ids: set[int]) -> set[int] | None:
        """Read which of these recordings there are; None while the database is away."""
        return await self._ask(lambda tx: recordings.read_present(tx, self._cell, recording_ids))

    async def flush(self) -> None:
        """Write the ends that wait; the recorder stops."""
        if self._ends:
            await self.read()

    def _write(self, tx: Transaction, recording_end: RecordingEnd) -> None:
        if recording_end.code in CONTINUED_ENDS:
            recordings.ask_again(tx, recording_end.id)
        recordings.end(
            tx, recording_end.id, recording_end.code, recording_end.progress, recording_end.ended_at
        )
        audit.record(
            tx,
            Source(recording_end.actor),
            "recording_ended",
            recording_end.robot,
            recording=recording_end.id,
            end_code=recording_end.code,
        )

    async def _ask(self, work: Callable[[Transaction], T]) -> T | None:
        try:
            result = await asyncio.to_thread(self._database.run, work)
        except StoreError as exc:
            if self.is_up:
                log.warning("the database is away: %s", exc)
            self.is_up = False
            return None
        self.is_up = True
        return result
