"""What a run has measured so far, one file a step, so that a run that was interrupted goes on where it was.

`runner` writes each outcome the moment it is known, failures too; the page is written from what stands here. Runs of
another scale have a folder of their own. Nothing is ever deleted: what is measured anew is moved to `old` before.

    FOLDER/SCALE/PART/STEP.json     outcome, commit and date of one step
    FOLDER/SCALE/invocations/*.json one file a process that ran steps: machine, versions, when
    FOLDER/SCALE/log                tracebacks of what failed
    FOLDER/SCALE/old/               what was measured before, by date
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from paper.step import Outcome, Part, Scale

INVOCATIONS, OLD = "invocations", "old"


class StoreBusyError(Exception):
    """Another process is measuring the same part."""


@dataclass(frozen=True, kw_only=True)
class StoredOutcome:
    """An outcome as it stands in its file."""

    outcome: Outcome
    # `git describe` of the sources that measured it.
    commit: str
    # RFC 3339, UTC.
    began: str
    # The process that measured it, as `Journal.sittings` calls it.
    invocation: str


def now() -> str:
    """RFC 3339 in UTC, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def scale_name(scale: Scale) -> str:
    """`quick`, `full` or `default`."""
    if scale.quick:
        return "quick"
    return "full" if scale.full else "default"


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Whole or not at all, whatever happens meanwhile; raises ValueError or TypeError for what JSON cannot carry."""
    text = json.dumps(content, allow_nan=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f"{path.name}.{os.getpid()}.new")
    with beside.open("w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)


class ResultStore:
    """The kept outcomes of one scale."""

    def __init__(self, folder: Path, scale: Scale) -> None:
        self.folder = folder / scale_name(scale)
        self.folder.mkdir(parents=True, exist_ok=True)
        started = datetime.now(UTC).strftime("%Y%m%dT%H%M%S")
        # What this process's sitting is called.
        self.invocation = f"{started}-{os.getpid()}"

    @property
    def log(self) -> Path:
        """Where tracebacks go."""
        return self.folder / "log"

    def write(self, part: Part, step: str, stored: StoredOutcome) -> None:
        """Keep an outcome; raises ValueError or TypeError if its values are not JSON."""
        write_json(self.folder / part.name / f"{step}.json", asdict(stored))

    def read(self, part: Part, steps: Sequence[str]) -> dict[str, StoredOutcome]:
        """What is kept of these steps, in their order; those that have not run are left out."""
        files = {name: self.folder / part.name / f"{name}.json" for name in steps}
        return {name: _stored(path) for name, path in files.items() if path.exists()}

    def set_aside(self, part: Part) -> None:
        """Move what is kept of a part away, so that it is measured anew."""
        source = self.folder / part.name
        if any(source.glob("*.json")):
            target = self.folder / OLD / self.invocation / part.name
            target.parent.mkdir(parents=True, exist_ok=True)
            source.rename(target)

    def write_invocation(self, invocation: Mapping[str, Any]) -> None:
        """Keep on what, and with which versions, this process measures; again when more is known."""
        write_json(self.folder / INVOCATIONS / f"{self.invocation}.json", invocation)

    def invocations(self, stored: Iterable[StoredOutcome]) -> list[Mapping[str, Any]]:
        """What is known of the processes that measured these, the first first."""
        names = sorted({one.invocation for one in stored})
        return [
            json.loads((self.folder / INVOCATIONS / f"{name}.json").read_text()) for name in names
        ]

    @contextmanager
    def held(self, parts: Sequence[Part]) -> Iterator[None]:
        """Keep other processes from measuring these parts; raises JournalBusyError if one does."""
        with open_files([self.folder / f"{part.name}.lock" for part in parts]) as files:
            for part, file in zip(parts, files, strict=True):
                _lock(file, part.name)
            yield


@contextmanager
def open_files(paths: Sequence[Path]) -> Iterator[list[int]]:
    """Descriptors of files, made where they are missing; closed, and so unlocked, at the end."""
    descriptors = [os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644) for path in paths]
    try:
        yield descriptors
    finally:
        for descriptor in descriptors:
            os.close(descriptor)


def _lock(descriptor: int, part: str) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise StoreBusyError(
            f"cannot measure {part}: another run of the same scale is measuring it; wait or stop it"
        ) from error


def _stored(path: Path) -> StoredOutcome:
    content = json.loads(path.read_text())
    return StoredOutcome(outcome=Outcome(**content.pop("outcome")), **content)
