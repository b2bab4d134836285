"""Patterns for names of topics and services, in which `*` stands for any text, `/` included.

A robot's policy is made of them. The time that a look takes grows with the lengths of name and
pattern and no faster, whoever chose either; so no regular expressions here. Pure.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

MAX_GLOB_LENGTH = 256
# What a name is made of, and `*`. Anything else could never match.
_GLOB = re.compile(r"[/*][A-Za-z0-9_/*]*")


def is_glob(text: str) -> bool:
    """Whether the text can match any name at all: a full name begins with `/`."""
    return len(text) <= MAX_GLOB_LENGTH and _GLOB.fullmatch(text) is not None and "//" not in text


@dataclass(frozen=True)
class Globs:
    """Some patterns; a name matches when one of them does. Equal when the patterns are."""

    patterns: tuple[str, ...]
    _plain: frozenset[str] = field(init=False, repr=False, compare=False)
    _split: tuple[tuple[str, ...], ...] = field(init=False, repr=False, compare=False)

    def __init__(self, patterns: Iterable[str] = ()) -> None:
        given = tuple(patterns)
        object.__setattr__(self, "patterns", given)
        object.__setattr__(self, "_plain", frozenset(p for p in given if "*" not in p))
        starred = (tuple(p.split("*")) for p in given if "*" in p)
        object.__setattr__(self, "_split", tuple(starred))

    def __iter__(self) -> Iterator[str]:
        return iter(self.patterns)

    def match(self, name: str) -> bool:
        """Whether the whole name is as one of the patterns says."""
        return name in self._plain or any(_matches(parts, name) for parts in self._split)


def _matches(parts: tuple[str, ...], name: str) -> bool:
    """Whether the name is these parts, in this order, with any text between them."""
    first, *middle, last = parts
    end = len(name) - len(last)
    if not (len(first) <= end and name.startswith(first) and name.endswith(last)):
        return False
    place = len(first)
    for part in middle:
        # The earliest place leaves most to the parts that follow, so there is nothing to try again.
        found = name.find(part, place, end)
        if found < 0:
            return False
        place = found + len(part)
    return True
