"""Processes as this machine numbers them, also of a container, for tests and experiments that hurt them one by one."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from docker.models.containers import Container

# Of proc(5)'s stat, counted from the state, which follows the name.
USER_TICKS, SYSTEM_TICKS, START = 11, 12, 19


def with_words(container: Container, words: str) -> list[int]:
    """Those with these whole words in their command, the oldest first: numbers begin anew when they are used up.

    Whole: a health check of `-m sim_robot.healthcheck` is no `-m sim_robot`, and is gone a moment later.
    """
    table = container.top(ps_args="-eo pid,args")["Processes"]
    told = re.compile(rf"(?<!\S){re.escape(words)}(?!\S)")
    found = [int(pid) for pid, command in table if told.search(command) and "tini" not in command]
    return sorted(found, key=_started)


def oldest(pids: Iterable[int]) -> int:
    """The one that started first, whatever its number."""
    return min(pids, key=_started)


def ticks(pid: int) -> int:
    """Processor time that a process has used so far, in the kernel's ticks."""
    fields = _fields(pid)
    return fields[USER_TICKS] + fields[SYSTEM_TICKS]


def _started(pid: int) -> int:
    return _fields(pid)[START]


def _fields(pid: int) -> list[int]:
    text = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2]
    return [0, *(int(field) for field in text.split()[1:])]
