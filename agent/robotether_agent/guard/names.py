"""Names of topics, and which of them drive the robot.

A robot must never read another name in a message than the guard did: only one spelling passes. Pure.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from fnmatch import fnmatchcase, translate

MAX_NAME_LENGTH = 255
MAX_PATTERN_LENGTH = 256
NAME = re.compile(r"/?[A-Za-z0-9_]+(?:/[A-Za-z0-9_]+)*", re.ASCII)
PATTERN = re.compile(rf"[A-Za-z0-9_/*]{{1,{MAX_PATTERN_LENGTH}}}", re.ASCII)


def full_name(name: object) -> str | None:
    """Return the name with its first slash, or None if it is spelled in any other way."""
    if not isinstance(name, str) or len(name) > MAX_NAME_LENGTH or not NAME.fullmatch(name):
        return None
    return name if name.startswith("/") else "/" + name


class DriveTopics:
    """The robot's drive topics: full names in which `*` stands for any text, slashes included."""

    def __init__(self, patterns: Sequence[str]) -> None:
        for pattern in patterns:
            if not PATTERN.fullmatch(pattern):
                raise ValueError(f"{pattern[:80]!r} is no name of a topic, with * for any text")
        self.patterns = tuple(patterns)
        # translate() makes an expression that cannot run for long, however many * there are.
        self._match = re.compile("|".join(map(translate, patterns)) or r"(?!)").match

    def match(self, full: str) -> bool:
        """Tell whether a full name is a drive topic's."""
        return self._match(full) is not None

    def might_be(self, relative: str) -> bool:
        """Tell whether a name without a first slash could be a drive topic's in some namespace of the robot."""
        last = relative.rpartition("/")[2]
        return any(fnmatchcase(last, pattern.rpartition("/")[2]) for pattern in self.patterns)

    def plain(self) -> list[str]:
        """Return those that are names and no patterns."""
        return [pattern for pattern in self.patterns if "*" not in pattern]
