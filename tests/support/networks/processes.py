"""Processes as this machine numbers them, also of a container, for tests and experiments that hurt them one by one."""

from __future__ import annotations

import re

from docker.models.containers import Container
from openssh_server import is_alive, words_of

# Of proc(5)'s stat, counted from the state, which follows the name.
START = 19


def with_words(container: Container, words: str) -> list[int]:
    """Those with these whole words in name and command, the oldest first: numbers begin anew when they are used up.

    Whole: a health check of `-m sim_robot.healthcheck` is no `-m sim_robot`, and is gone a moment later.
    """
    return matching(container, rf"(?<!\S){re.escape(words)}(?!\S)")


def matching(container: Container, pattern: str) -> list[int]:
    """Those in whose name and command, with a space between, the pattern is found, the oldest first."""
    table = container.top(ps_args="-eo pid,comm,args")["Processes"]
    found = [
        int(pid)
        for pid, *named in table
        if re.search(pattern, " ".join(named)) and "tini" not in named[-1]
    ]
    return sorted(filter(is_alive, found), key=lambda pid: int(words_of(pid)[START]))
