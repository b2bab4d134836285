"""Keeps on the relay's disk what the database has not accepted yet, for the relay after one that was killed.

`event_writer` appends each entry when it is added, and empties the file when nothing waits any more. A thread writes,
so that a disk that is slow or hangs holds up no message to a robot. The kernel has a line moments after `add`, so the
death of the process loses nothing older; a power cut may lose the last seconds, since nothing here waits for the disk.
A disk that is full or cannot be written costs the journal, never the relay.

A relay that is killed between the commit of entries and the end of the journal leaves what is written already. Written
again, drives, leases, stops and open requests are the same; a line of the audit log is there twice.
"""

from __future__ import annotations

import errno
import logging
import os
import stat
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from datetime import datetime, timezone
from io import FileIO
from pathlib import Path
from typing import get_args

import msgspec
from msgspec import Raw, Struct

from robotether_server.db.control import DriveEntry, LeaseEnd, LeaseStart, StopEntry
from robotether_server.db.fleet import AuditEntry, HelpEntry
from robotether_server.db.routes import RouteEnd

log = logging.getLogger(__name__)

# In a volume of the relay's own.
JOURNAL = Path("/var/lib/robotether/relay/journal.jsonl")
# A new relay ends what was left open; nobody was told that sessions are written.
JournalEntry = LeaseStart | LeaseEnd | DriveEntry | StopEntry | AuditEntry | HelpEntry | RouteEnd
# Maximum number of lines of written or replaced entries, beyond one per waiting entry.
MAX_STALE_LINES = 1000
RETRY_EVERY_S = 10.0
# Maximum number of tasks that wait for a hanging disk; further ones are only in memory.
MAX_TASKS = 10_000
# Time limit for the disk at the relay's end.
CLOSE_WITHIN_S = 0.5
_KINDS = {kind.__name__: kind for kind in get_args(JournalEntry)}


class JournalLine(Struct, frozen=True):
    """A line of the file; `at` is when it was written."""

    at: datetime
    kind: str
    entry: Raw


class Journal:
    """One file with a line of JSON for each entry."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.folder = path.parent
        # All that follows is the thread's, but for reading.
        self._disk = ThreadPoolExecutor(1, thread_name_prefix="journal")
        self._submitted = self._done = 0
        # It stays open: a file that is emptied and then closed would be written to the disk at once.
        self._file: FileIO | None = None
        self._lines = 0
        # The disk refused a line. What is added since is in memory alone, until the whole is written anew.
        self._is_failing = False
        self._retry_at = 0.0

    def read(self) -> list[JournalEntry]:
        """Return what the relay before this one left, in its order.

        A drive, and a robot's stops, are there once, with the newest state.
        """
        try:
            with FileIO(self._path, opener=_open_regular) as file:
                lines = [line for line in file.readall().split(b"\n") if line]
        except FileNotFoundError:
            return []
        except OSError as problem:
            self._fail(problem)
            return []
        self._lines = len(lines)
        entries: dict[tuple[object, ...], JournalEntry] = {}
        unread = 0
        for number, line in enumerate(lines):
            entry = _parse(line)
            if entry is None:
                unread += 1
            else:
                entries[_key(entry, number)] = entry
        if unread:
            log.warning("%d lines of %s cannot be read; they are left out", unread, self._path)
        return list(entries.values())

    def add(self, entry: JournalEntry) -> None:
        """Keep an entry, also when it is kept already in an older state."""
        if not self._is_failing:
            self._submit(self._append, _line(entry))

    def needs_rewrite(self, count: int) -> bool:
        """Return whether `rewrite` is due for `waiting` entries: the file is long, or lacks some of them."""
        if self._submitted > self._done:
            return False
        if self._is_failing:
            return time.monotonic() >= self._retry_at
        return self._lines > 2 * count + MAX_STALE_LINES

    def rewrite(self, entries: Iterable[JournalEntry]) -> None:
        """Keep these alone, in a new file that takes the old one's place."""
        self._submit(self._replace, [_line(entry) for entry in entries])

    def clear(self) -> None:
        """Keep nothing: all is written."""
        self._submit(self._truncate)

    def wait(self, within_s: float) -> None:
        """Wait until the added entries are written, at most `within_s`."""
        with suppress(TimeoutError):
            self._disk.submit(int).result(within_s)

    def close(self) -> None:
        """Let the file go; what it has is for the next relay."""
        self._submit(self._close_file)
        self.wait(CLOSE_WITHIN_S)
        self._disk.shutdown(wait=False)

    def _submit(self, work: Callable[..., None], *values: object) -> None:
        """Have the thread do it, behind what it was asked before."""
        if self._submitted - self._done >= MAX_TASKS:
            self._fail(TimeoutError("the disk does not answer"))
            return
        self._submitted += 1
        self._disk.submit(self._do, work, *values)

    def _do(self, work: Callable[..., None], *values: object) -> None:
        try:
            work(*values)
        except OSError as problem:
            self._fail(problem)
        except Exception:
            log.exception("cannot write the journal")
        finally:
            self._done += 1

    def _append(self, line: bytes) -> None:
        # Behind a line that is missing, what follows would look whole.
        if not self._is_failing:
            _write(self._opened(), line)
            self._lines += 1

    def _truncate(self) -> None:
        if self._lines:
            self._opened().truncate(0)
            self._lines = 0

    def _close_file(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def _opened(self) -> FileIO:
        if self._file is None:
            self._file = FileIO(self._path, "a", opener=_open_regular)
        return self._file

    def _replace(self, lines: list[bytes]) -> None:
        new = self._path.with_suffix(".new")
        try:
            with FileIO(new, "w", opener=_open_regular) as file:
                _write(file, b"".join(lines))
            new.replace(self._path)
        except OSError:
            with suppress(OSError):
                new.unlink()
            raise
        # The next line opens the new one.
        self._close_file()
        self._lines = len(lines)
        if self._is_failing:
            log.warning("the journal %s can be written again", self._path)
        self._is_failing = False

    def _fail(self, problem: OSError) -> None:
        self._retry_at = time.monotonic() + RETRY_EVERY_S
        if not self._is_failing:
            log.error(
                "cannot write the journal: %s; a relay that is killed now loses what waits", problem
            )
        self._is_failing = True


def _open_regular(path: str, flags: int) -> int:
    """Open a file of our own: a link leads to another's, and a FIFO would hold the relay's start."""
    descriptor = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK, 0o600)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "it is no regular file", path)
    return descriptor


def _line(entry: JournalEntry) -> bytes:
    # The end of a line comes first: what a full disk cut short before spoils no other.
    try:
        at, kind = datetime.now(timezone.utc), type(entry).__name__
        return b"\n" + msgspec.json.encode({"at": at, "kind": kind, "entry": entry})
    except (msgspec.MsgspecError, TypeError, ValueError) as problem:
        # Text that is no Unicode: nor does the database accept it.
        log.warning("cannot keep %r in the journal: %s", entry, problem)
        return b""


def _write(file: FileIO, data: bytes) -> None:
    if file.write(data) != len(data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _parse(data: bytes) -> JournalEntry | None:
    """Read a line; None: it was cut short by a full disk, or is of another version."""
    try:
        line = msgspec.json.decode(data, type=JournalLine)
        entry: JournalEntry = msgspec.json.decode(line.entry, type=_KINDS[line.kind])
    except (ValueError, KeyError, RecursionError):
        return None
    if not isinstance(entry, DriveEntry):
        return entry
    # A database that was restored since may have another drive at this id; robot and fence find its row.
    drive = replace(entry, row_id=None)
    if drive.ended_at is None:
        # It ended with its relay, and not only when this one writes it.
        drive.ended_at, drive.end_code = line.at, "relay_restarted"
    return drive


def _key(entry: JournalEntry, number: int) -> tuple[object, ...]:
    """Return what lines of one drive, of one robot's stops, or of its calls for help have in common."""
    match entry:
        case DriveEntry():
            return DriveEntry, entry.robot_id, entry.fence
        case StopEntry():
            return StopEntry, entry.robot_id
        case HelpEntry():
            return HelpEntry, entry.robot_id, entry.source
    return (number,)
