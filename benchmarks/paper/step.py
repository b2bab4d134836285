"""What an experiment is made of: steps that run once each, their outcomes, and what its page says of them.

`experiments.py` runs steps and keeps outcomes. A part's `report` turns outcomes into rows and values for its template
and must be pure, so that the page can be written again from the outcomes.
"""

from __future__ import annotations

import fcntl
import json
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from report import Row, cell, plain

if TYPE_CHECKING:
    from paper.world import World

# What JSON can carry.
Values = Mapping[str, Any]
# A step by the names of its part and its own.
Key = tuple[str, str]


@dataclass(frozen=True, kw_only=True)
class Scale:
    """How much is run."""

    # Everything once and small, for continuous integration.
    quick: bool = False
    # What lasts, for longer.
    full: bool = False

    @property
    def name(self) -> str:
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
    # `git describe` of the sources that measured it, on what, and which versions ran.
    commit: str = ""
    machine: str = ""
    versions: str = ""


# Outcomes by their steps' names, in the steps' order; a step that has not run is not in it.
Results = Mapping[str, Outcome]


@dataclass(frozen=True)
class Comparison:
    """A row of the page's first table: our figure beside that of the paper, of an aim or of a rule."""

    what: str
    against: str
    reference: float
    ours: float
    unit: str
    # Which way is better: "lower", or "equal", which has to be met exactly.
    better: str

    @property
    def ratio(self) -> float | None:
        """Ours divided by the reference; None where that is zero."""
        return None if self.reference == 0 else self.ours / self.reference

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
            "ratio": self.ratio,
            "better is": self.better,
            "verdict": "**falls short**" if self.is_short else "met",
        }


def against_aim(what: str, aim: float, ours: float | None, unit: str) -> Comparison:
    """Our value beside the most that it should be; one that was not reached at all is no number, which falls short."""
    return Comparison(what, "aim", aim, math.nan if ours is None else ours, unit, "lower")


def exactly(what: str, against: str, reference: float, ours: float, unit: str) -> Comparison:
    """Our value beside the one that it has to be: another one fails the run."""
    return Comparison(what, against, reference, ours, unit, "equal")


@dataclass(frozen=True, kw_only=True)
class Report:
    """What the page says of one experiment."""

    # What the part's template names, its tables' rows among them.
    values: Mapping[str, Any] = field(default_factory=dict)
    comparisons: Sequence[Comparison] = ()
    # What falls short beside the comparisons that do, in sentences.
    shortfalls: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True)
class Part:
    """One experiment; its page is templates/NAME.md.j2."""

    # For the results and for ONLY: "density".
    name: str
    title: str
    steps: Callable[[Scale], Sequence[Step]]
    # Only of steps of this scale.
    report: Callable[[Scale, Results], Report]


def succeeded(results: Results) -> dict[str, Values]:
    """What was measured in the steps that did not fail."""
    return {name: result.values for name, result in results.items() if result.values is not None}


def now() -> str:
    """RFC 3339 in UTC, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


class ResultStore:
    """Outcomes of one scale, a line each in FOLDER/SCALE.jsonl; a file with a date has what is measured anew."""

    def __init__(self, folder: Path, scale: Scale) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / f"{scale.name}.jsonl"

    def lock(self) -> None:
        """Keep other processes from measuring until this one ends; BlockingIOError if one does."""
        self._lock = self.path.with_suffix(".lock").open("a")
        fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def add(self, key: Key, outcome: Outcome) -> None:
        part, step = key
        line = {"part": part, "step": step, "outcome": asdict(outcome)}
        with self.path.open("a") as file:
            file.write(f"{json.dumps(line)}\n")

    def keys(self) -> set[Key]:
        return {(line["part"], line["step"]) for line in self._lines()}

    def outcomes(self, part: Part, scale: Scale) -> dict[str, Outcome]:
        """What is kept of a part's steps, in their order; those that have not run are left out."""
        lines = self._lines()
        kept = {
            line["step"]: Outcome(**line["outcome"]) for line in lines if line["part"] == part.name
        }
        return {step.name: kept[step.name] for step in part.steps(scale) if step.name in kept}

    def set_aside(self, keys: Collection[Key]) -> None:
        """Begin anew without what is kept of these steps; the file as it was gets another name."""
        if not self.keys() & set(keys):
            return
        lines = self._lines()
        self.path.rename(self.path.with_stem(f"{self.path.stem}-{now()}"))
        kept = [line for line in lines if (line["part"], line["step"]) not in keys]
        self.path.write_text("".join(f"{json.dumps(line)}\n" for line in kept))

    def _lines(self) -> list[dict[str, Any]]:
        if not self.path.exists():
            return []
        return [json.loads(line) for line in self.path.read_text().splitlines()]
