"""What an experiment is made of: steps that run once each, what became of them, and what the page makes of that.

Everything here is data; `runner` runs steps and keeps outcomes, an experiment's `report` turns outcomes into a page's
part and must be pure, so that a page can be written again from what was kept.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sections import Section

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

    from paper.world import World

# What JSON can carry.
Values = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Scale:
    """How much is run."""

    # Everything once and small, for continuous integration.
    quick: bool = False
    # The paper's 1000 repetitions of the start, in place of 20.
    full: bool = False

    @property
    def name(self) -> str:
        """`quick`, `full` or `default`."""
        if self.quick:
            return "quick"
        return "full" if self.full else "default"


@dataclass(frozen=True, kw_only=True)
class Step:
    """One repetition or one measured run; it succeeds or fails as a whole, and is run once."""

    # Unique in its part.
    name: str
    # For people: "50 robots, repetition 7 of 20".
    title: str
    # For what is said of the time that is left.
    expected_s: float
    # Returns what was measured; any exception is this step's failure.
    run: Callable[[World], Values]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of one step."""

    values: Values | None = None
    # Why it failed, in a sentence; empty when it did not.
    failure: str = ""
    took_s: float = 0.0
    # The machine's load average over a minute, when the step began.
    load: float = 0.0
    # RFC 3339, UTC.
    began: str = ""
    # `git describe` of the sources that measured it.
    commit: str = ""
    # When the process that measured it began.
    sitting: str = ""


# Outcomes by their steps' names, in the steps' order; a step that has not run is not in it.
Results = Mapping[str, Outcome]


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A row of the page's first table: what the paper (or another way) has, and what we have."""

    what: str
    # Whose figure the reference is: "paper", "bare ssh -R", ...
    against: str
    reference: float
    ours: float
    unit: str
    # Which way is better: "lower", "higher" or "equal", which has to be met exactly.
    better: str

    @property
    def ratio(self) -> float | None:
        """Ours divided by the reference; None where that is zero."""
        return None if self.reference == 0 else self.ours / self.reference

    @property
    def is_short(self) -> bool:
        """Whether ours is worse than the reference; what is no number is."""
        if not math.isfinite(self.ours):
            return True
        if self.better == "lower":
            return self.ours > self.reference
        return (
            self.ours < self.reference if self.better == "higher" else self.ours != self.reference
        )


@dataclass(frozen=True, kw_only=True)
class Plot:
    """A figure of the page."""

    # Without its ending: "spiral-fixed" becomes spiral-fixed.svg.
    name: str
    # What it shows, for those who cannot see it, and the caption.
    caption: str
    draw: Callable[[Drawing], None]


@dataclass(frozen=True, kw_only=True)
class Data:
    """A CSV file beside the page; `about` is its first line, behind a #."""

    name: str
    about: str
    header: Sequence[str]
    rows: Sequence[Sequence[object]]


@dataclass(frozen=True, kw_only=True)
class Report:
    """What the page says of one experiment."""

    sections: Sequence[Section]
    comparisons: Sequence[Comparison] = ()
    plots: Sequence[Plot] = ()
    data: Sequence[Data] = ()
    # What was seen that falls short of the paper, of a peer or of an aim, in sentences.
    shortfalls: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True)
class Part:
    """One experiment."""

    # For the results and --only: "high_rate".
    name: str
    title: str
    steps: Callable[[Scale], Sequence[Step]]
    # Only of steps of this scale.
    report: Callable[[Scale, Results], Report]


def succeeded(results: Results) -> dict[str, Values]:
    """What was measured in the steps that did not fail."""
    return {name: one.values for name, one in results.items() if one.values is not None}


def failures(results: Results) -> list[str]:
    """`NAME: WHY` of the steps that failed."""
    return [f"{name}: {one.failure}" for name, one in results.items() if one.values is None]


def spread(values: Sequence[float]) -> float:
    """The standard deviation of a sample; 0 of a single value."""
    return statistics.stdev(values) if len(values) > 1 else 0.0
