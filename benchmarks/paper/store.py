"""What was measured so far, in FOLDER/SCALE.jsonl: a line a step, and one for each sitting, a process that ran steps.

Nothing is ever lost: what is measured anew goes to a file with its date before. FOLDER/SCALE.log has the tracebacks of
what failed. The page is written from what stands here.
"""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from paper.step import Outcome, Part, Scale


class StoreBusyError(Exception):
    """Another process measures at the same scale."""


def now() -> str:
    """RFC 3339 in UTC, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


class ResultStore:
    """The outcomes and sittings of one scale."""

    def __init__(self, folder: Path, scale: Scale) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / f"{scale.name}.jsonl"
        self.log = folder / f"{scale.name}.log"

    def add(self, part: Part, step: str, outcome: Outcome) -> None:
        """Keep what became of a step."""
        self._write({"part": part.name, "step": step, "outcome": asdict(outcome)})

    def add_sitting(self, sitting: Mapping[str, Any]) -> None:
        """Keep on what, and with which versions, is measured from now on; outcomes name it by its `began`."""
        self._write({"sitting": dict(sitting)})

    def outcomes(self, part: Part, scale: Scale) -> dict[str, Outcome]:
        """What is kept of a part's steps, in their order; those that have not run are left out."""
        kept = {
            line["step"]: line["outcome"] for line in self._lines() if line.get("part") == part.name
        }
        return {
            step.name: Outcome(**kept[step.name]) for step in part.steps(scale) if step.name in kept
        }

    def sittings(self, outcomes: Sequence[Outcome]) -> list[Mapping[str, Any]]:
        """What is known of the processes that measured these, the first first."""
        wanted = {one.sitting for one in outcomes}
        known = (line["sitting"] for line in self._lines() if "sitting" in line)
        return [sitting for sitting in known if sitting["began"] in wanted]

    def set_aside(self, parts: Sequence[Part]) -> None:
        """Begin anew without what is kept of these parts; the file as it was gets another name."""
        names = [part.name for part in parts]
        lines = self._lines()
        if any(line.get("part") in names for line in lines):
            self.path.rename(self.path.with_stem(f"{self.path.stem}-{now()}"))
            for line in lines:
                if line.get("part") not in names:
                    self._write(line)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep other processes from measuring meanwhile; raises StoreBusyError if one does."""
        with self.log.open("a") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise StoreBusyError(
                    "cannot measure: another run of the same scale is measuring; wait or stop it"
                ) from error
            yield

    def _write(self, line: Mapping[str, Any]) -> None:
        with self.path.open("a") as file:
            file.write(f"{json.dumps(line)}\n")

    def _lines(self) -> list[dict[str, Any]]:
        if not self.path.exists():
            return []
        return [json.loads(line) for line in self.path.read_text().splitlines()]
