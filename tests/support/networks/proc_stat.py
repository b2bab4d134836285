"""What the kernel says of processes in /proc/PID/stat; some end while they are read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

PROC = Path("/proc")


def words_of(pid: int, proc: Path = PROC) -> list[str]:
    """Those of proc(5) behind the name, from the state on; OSError when there is no such process any more."""
    return (proc / str(pid) / "stat").read_text().rpartition(")")[2].split()


def words_of_all(proc: Path = PROC) -> Iterator[tuple[int, list[str]]]:
    for path in proc.iterdir():
        # Not by a pattern: pathlib stumbles over a process that ends while it looks.
        if not path.name.isdigit():
            continue
        try:
            words = words_of(int(path.name), proc)
        except (FileNotFoundError, ProcessLookupError):
            continue
        yield int(path.name), words
