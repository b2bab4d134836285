"""The history of a run of cells: what robots, people and the nemesis did and saw, a line of JSON for each event.

Each process writes a file of its own at once, so that what it saw outlives it. All run on one machine and share its
monotonic clock.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Literal

Kind = Literal[
    # At a robot. A command came to its guard; its rosbridge got one that moves, or a zero.
    "arrived",
    "moved",
    "zeroed",
    # Its guard confirmed a stop or a release, began, or was killed.
    "stopped",
    "released",
    "guard_began",
    "guard_killed",
    # It has a session at a cell, or lost it; the process that plays it was held up for `number` ms.
    "session",
    "session_lost",
    "late",
    # A driver wants to drive, or does no more; `what` stood in the way of one attempt.
    "wants",
    "leaves",
    "refused",
    # An operator stops or releases. `done` is the server's word that it is; `what` of a stop is its reason.
    "stop_asked",
    "stop_done",
    "release_asked",
    "release_done",
    # The server confirmed that it has written `what`.
    "recorded",
    # Somebody asked for help by request `what`; `connection` polled the queue, and has accepted a request.
    "request_made",
    "polled",
    "accepted",
    # The nemesis did `what`, and took it back.
    "fault",
    "healed",
]


@dataclass(frozen=True, kw_only=True)
class Event:
    """One of them; what does not belong to its kind is empty."""

    at_s: float
    kind: Kind
    robot: str = ""
    # The name of a driver's connection; each dial is another one.
    connection: str = ""
    # A command's, in its connection.
    number: int = 0
    fence: int = 0
    # Empty: all of them.
    cell: str = ""
    epoch: int = 0
    what: str = ""
    # The process that saw it; of a fault, the one whose robots are concerned, empty: all.
    source: str = ""


ENDING = ".jsonl"


class History:
    def __init__(self, file: IO[str], source: str) -> None:
        self._file, self._source = file, source

    @classmethod
    def open(cls, folder: Path, source: str) -> History:
        return cls((folder / f"{source}{ENDING}").open("a", buffering=1), source)

    def add(self, kind: Kind, **more: Any) -> None:
        event = {"at_s": time.monotonic(), "kind": kind, "source": self._source, **more}
        self._file.write(f"{json.dumps(event)}\n")

    def close(self) -> None:
        self._file.close()


def read(folder: Path) -> list[Event]:
    """All that was written there, in the order of time; the last line of a process that was killed may be half."""
    events = (
        Event(**json.loads(line))
        for path in sorted(folder.glob(f"*{ENDING}"))
        for line in path.read_text().splitlines(keepends=True)
        if line.endswith("\n")
    )
    return in_order(events)


def in_order(events: Iterable[Event]) -> list[Event]:
    return sorted(events, key=lambda event: event.at_s)


def by_robot(events: Sequence[Event]) -> dict[str, list[Event]]:
    found: dict[str, list[Event]] = {}
    for event in events:
        if event.robot:
            found.setdefault(event.robot, []).append(event)
    return found
