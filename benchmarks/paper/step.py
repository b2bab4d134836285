"""What an experiment is made of: steps that run once each, their outcomes, and what its page says of them.

A part's `report` turns what its steps measured into rows and values for its template, and is pure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from report import Row, cell, plain

if TYPE_CHECKING:
    from paper.world import World

# What JSON can carry.
Values = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Scale:
    # Everything once and small, for continuous integration.
    quick: bool = False
    # What lasts, for longer.
    full: bool = False


@dataclass(frozen=True, kw_only=True)
class Step:
    """One repetition or one measured run; it succeeds or fails as a whole, and is run once."""

    # Unique in its part.
    name: str
    # For people: "50 robots, repetition 7 of 20".
    title: str
    # Returns what was measured; any exception is this step's failure.
    run: Callable[[World], Values]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    title: str
    # None: it failed.
    values: Values | None
    failure: str
    took_s: float
    # The machine's load average over a minute, and the time in RFC 3339, when the step began.
    load: float
    began: str


@dataclass(frozen=True)
class Comparison:
    """A row of the page's first table: our figure beside that of an aim or of a rule."""

    what: str
    against: str
    reference: float
    ours: float
    unit: str

    @property
    def better(self) -> str:
        """Which way: an aim is reached by less too, a rule has to be met exactly."""
        return "lower" if self.against == "aim" else "equal"

    @property
    def is_short(self) -> bool:
        """Whether ours is worse than the reference; what is no number is."""
        is_equal = self.ours == self.reference
        return not (is_equal or (self.better == "lower" and self.ours < self.reference))

    @property
    def row(self) -> Row:
        return {
            "what": plain(self.what),
            "against": plain(self.against),
            "reference": plain(f"{cell(self.reference)} {self.unit}"),
            "ours": plain(f"{cell(self.ours)} {self.unit}"),
            "ratio": self.ours / self.reference if self.reference else None,
            "better is": self.better,
            "verdict": "**falls short**" if self.is_short else "met",
        }


def against_aim(what: str, aim: float, ours: float | None, unit: str) -> Comparison:
    """Our value beside the most that it should be; one that was not reached at all is no number, which falls short."""
    return Comparison(what, "aim", aim, math.nan if ours is None else ours, unit)


def never(what: str, ours: float, unit: str = "times") -> Comparison:
    return Comparison(what, "rule", 0, ours, unit)


@dataclass(frozen=True, kw_only=True)
class Report:
    # What the part's template names, its tables' rows among them.
    values: Mapping[str, Any] = field(default_factory=dict)
    comparisons: Sequence[Comparison] = ()
    # What falls short beside the comparisons that do, in sentences.
    shortfalls: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True)
class Part:
    # For the results and for ONLY: "density".
    name: str
    title: str
    steps: Callable[[Scale], Sequence[Step]]
    # Of what was measured in the steps that did not fail, by their names.
    report: Callable[[Mapping[str, Values]], Report]


def now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
