"""The stop: held in memory at once, then written to disk, then reported; a release in the opposite order.

Kept by the guard's process. The disk may be slow, so it works in a thread, one message after the other. A stop that
comes while a release is written wins. A disk that fails keeps no stop, but the robot is stopped, and reported as
stopped: nothing else would be true, and the server keeps the stop as well. A disk that hangs lets a bounded number of
messages wait, the newest stop always among them.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from robotether_agent.fields import FieldError, get_text, parse_object
from robotether_agent.files import read_text, remove, write_atomic
from robotether_agent.guard.agent_messages import MAX_BY_LENGTH, ReleaseRequest, StopRequest
from robotether_agent.problems import StateUnusableError

STOP_FILE = "stop.json"
MAX_WAITING = 100

log = logging.getLogger(__name__)


class StopFile:
    """The latch on the disk."""

    def __init__(self, state_dir: Path) -> None:
        self._path = state_dir / STOP_FILE

    def read(self) -> str | None:
        """Return who stopped the robot, or None when it is not stopped."""
        try:
            text = read_text(self._path)
            return (
                None
                if text is None
                else get_text(parse_object(text, STOP_FILE), "by", limit=MAX_BY_LENGTH)
            )
        except (StateUnusableError, FieldError) as error:
            log.error("%s cannot be read, so the robot is stopped: %s", self._path, error)  # noqa: TRY400 - no defect
            return ""

    def write(self, by: str) -> None:
        """Keep the stop; StateUnusableError when that fails."""
        write_atomic(self._path, json.dumps({"by": by}) + "\n", 0o600)

    def remove(self) -> None:
        """Let the stop end; StateUnusableError when that fails."""
        remove(self._path)


@dataclass
class _Job:
    message: StopRequest | ReleaseRequest
    stops_before: int
    waits: bool = True


class Latch:
    """Whether the robot is stopped, and by whom."""

    def __init__(
        self, file: StopFile, changed: Callable[[], None], answer: Callable[[str], None]
    ) -> None:
        self._file = file
        self._changed = changed
        self._answer = answer
        self._jobs: asyncio.Queue[_Job] = asyncio.Queue()
        self._newest: _Job | None = None
        self._stops = 0
        by = file.read()
        self.stopped = by is not None
        self.by = by or ""
        # Who stopped the robot, for others to know: None while it is not stopped, or its disk has not answered yet.
        self.reported_by = by

    def handle(self, message: StopRequest | ReleaseRequest) -> None:
        """Stop now, or release as soon as the disk has it."""
        if isinstance(message, StopRequest):
            self._stops += 1
            self.stopped, self.by = True, message.by
            self._changed()
            self._put_stop(message)
        elif self._jobs.qsize() < MAX_WAITING:
            self._put(message)

    def _put_stop(self, message: StopRequest) -> None:
        """Have the stop written after the release before it; it takes the place of a stop that still waits there."""
        newest = self._newest
        if newest is not None and newest.waits and isinstance(newest.message, StopRequest):
            # Nobody misses the older one's answer: the agent waits for its newest stop's, the server for releases'.
            newest.message = message
        else:
            self._put(message)

    def _put(self, message: StopRequest | ReleaseRequest) -> None:
        self._newest = _Job(message, self._stops)
        self._jobs.put_nowait(self._newest)

    async def run(self) -> None:
        """Do what was ordered, without end."""
        while True:
            job = await self._jobs.get()
            job.waits = False
            try:
                await asyncio.to_thread(self._on_disk, job.message)
            except StateUnusableError as problem:
                log.error("%s; %s", problem, _despite_the_disk(job.message))  # noqa: TRY400 - no defect
            else:
                self._released(job)
            if isinstance(job.message, StopRequest):
                self.reported_by = job.message.by
            self._answer(job.message.id)
            self._jobs.task_done()

    async def settled(self) -> None:
        """Return when the disk has all that was ordered."""
        await self._jobs.join()

    def _on_disk(self, message: StopRequest | ReleaseRequest) -> None:
        if isinstance(message, StopRequest):
            self._file.write(message.by)
        else:
            self._file.remove()

    def _released(self, job: _Job) -> None:
        # One that a newer stop overtook changes nothing, nor what is reported: nobody may mistake it for a release.
        if isinstance(job.message, ReleaseRequest) and job.stops_before == self._stops:
            log.info("%s released the robot", job.message.by or "somebody")
            self.stopped, self.by, self.reported_by = False, "", None
            self._changed()


def _despite_the_disk(message: StopRequest | ReleaseRequest) -> str:
    if isinstance(message, StopRequest):
        return "the robot is stopped, but will not remember it after a loss of power"
    return "the robot stays stopped"
