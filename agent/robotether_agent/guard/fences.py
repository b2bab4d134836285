"""Keeps the newest number of a lease on the disk, so that no older one drives after a restart of guard or robot.

Kept by the guard's process. The disk may be slow, so it works in a thread, one write after the other. A number is
there before a driver with it is let in. A disk that cannot be written lets nobody in: the next guard would not know
the number, and could let an older one drive.
"""

from __future__ import annotations

import asyncio
import json
import logging
from pathlib import Path

from robotether_common.session import MAX_FENCE

from robotether_agent.fields import FieldError, get_int, parse_object
from robotether_agent.files import read_text, write_atomic
from robotether_agent.problems import StateUnusableError

FENCE_FILE = "fence.json"

log = logging.getLogger(__name__)


class FenceFile:
    """The newest number on the disk."""

    def __init__(self, state_dir: Path) -> None:
        self._path = state_dir / FENCE_FILE

    def read(self) -> int:
        """Return the number, or 0 when none is known."""
        try:
            text = read_text(self._path)
            if text is None:
                return 0
            return get_int(parse_object(text, FENCE_FILE), "fence", 0, MAX_FENCE)
        except (StateUnusableError, FieldError) as error:
            # It is written whole or not at all. The server sends its own number before anybody drives.
            log.error("%s cannot be read, so the server's number counts: %s", self._path, error)  # noqa: TRY400 - no defect
            return 0

    def write(self, fence: int) -> None:
        """Keep the number; StateUnusableError when that fails."""
        # Not synced, which takes seconds on a memory card that is written to: a driver waits for this. A loss of
        # power also ends whatever could come with an older number.
        write_atomic(self._path, json.dumps({"fence": fence}) + "\n", 0o600, lasts=False)


class FenceStore:
    """Brings the newest number to the disk, which never gets an older one after it."""

    def __init__(self, file: FenceFile) -> None:
        self._file = file
        # What the disk has.
        self.on_disk = file.read()
        self._newest = self.on_disk
        self._writing: asyncio.Task[StateUnusableError | None] | None = None

    def note(self, fence: int) -> None:
        """Begin to write a number that is newer."""
        self._newest = max(self._newest, fence)
        is_busy = self._writing is not None and not self._writing.done()
        if self._newest > self.on_disk and not is_busy:
            self._writing = asyncio.create_task(self._write())

    async def keep(self, fence: int) -> None:
        """Return once the disk has this number or a newer one; StateUnusableError when it cannot be written."""
        self.note(fence)
        if fence > self.on_disk and self._writing is not None:
            # A client that leaves meanwhile must not leave a thread behind that writes beside the next one.
            problem = await asyncio.shield(self._writing)
            if problem is not None:
                raise problem

    async def settled(self) -> None:
        """Return when nothing is being written."""
        if self._writing is not None:
            await asyncio.wait({self._writing})

    async def _write(self) -> StateUnusableError | None:
        while (newest := self._newest) > self.on_disk:
            try:
                await asyncio.to_thread(self._file.write, newest)
            except StateUnusableError as problem:
                log.error("%s; nobody can drive with lease %d", problem, newest)  # noqa: TRY400 - no defect
                return problem
            self.on_disk = newest
        return None
