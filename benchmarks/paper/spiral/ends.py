"""What the spirals came to: each run's outcome, and where the spread of the ends comes from. Pure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from sim_robot.kinematics import STANDING, Pose, Velocity

from paper.spiral.course import NETWORKS, Change, end_of
from paper.step import Results, spread, succeeded

# Of runs that failed; the file has all.
MAX_REPORTED = 3


@dataclass(frozen=True)
class Run:
    """One robot's spiral; lengths in m, times in ms from its first command's sending."""

    network: str
    repetition: int
    pair: int
    # Why it was not driven to its end; empty when it was.
    failure: str
    sent_ms: Sequence[float]
    arrived_ms: Sequence[float]
    # Where it came to stand, seen from its start; None: nobody saw it.
    end: Pose | None
    # How many of turtlesim's steps it moved, and how far by their sum.
    steps: int
    travelled_m: float
    # (x, y) of every third step, seen from its start.
    path: Sequence[tuple[float, float]]

    @property
    def latencies_ms(self) -> list[float]:
        """How long each command was on its way."""
        return [there - sent for sent, there in zip(self.sent_ms, self.arrived_ms, strict=False)]


@dataclass(frozen=True)
class Spread:
    """Standard deviations of ends, in m."""

    x_m: float
    y_m: float

    @classmethod
    def of(cls, ends: Sequence[Pose]) -> Spread:
        return cls(spread([end.x for end in ends]), spread([end.y for end in ends]))


def runs(results: Results) -> list[Run]:
    """Every run of the drives that succeeded, in their order."""
    return [
        _run(values["repetition"], pair)
        for values in succeeded(results).values()
        for pair in values["pairs"]
    ]


def on(network: str, given: Sequence[Run]) -> list[Run]:
    """Those on one network, by its short name."""
    return [run for run in given if run.network == network]


def completed(given: Sequence[Run]) -> list[Run]:
    return [run for run in given if not run.failure]


def ends(given: Sequence[Run]) -> list[Pose]:
    return [run.end for run in completed(given) if run.end is not None]


def arrival_end(run: Run, wanted: Sequence[Velocity]) -> Pose:
    """Where a robot without steps ends that follows this run's commands as they arrived."""
    reported = zip(run.arrived_ms, [*wanted, STANDING], strict=True)
    return end_of([Change(at_ms / 1000, velocity) for at_ms, velocity in reported])


def intervals_ms(times_ms: Sequence[float]) -> list[float]:
    return [later - sooner for sooner, later in pairwise(times_ms)]


def of_commonest_steps(given: Sequence[Run]) -> list[Run]:
    """Those of the completed runs that took the number of steps that most of them took."""
    if not (done := completed(given)):
        return []
    [(commonest, _)] = Counter(run.steps for run in done).most_common(1)
    return [run for run in done if run.steps == commonest]


def off_m(given: Sequence[Run], ideal: Pose) -> list[float]:
    """How far from the ideal end the completed ones stood."""
    return [math.dist((end.x, end.y), (ideal.x, ideal.y)) for end in ends(given)]


def failed(network: str, given: Sequence[Run]) -> str:
    """A sentence on those on one network that were not driven to their ends; empty when all were."""
    here = on(network, given)
    lost = [run for run in here if run.failure]
    if not lost:
        return ""
    reported = [f"repetition {run.repetition}, pair {run.pair}: {run.failure}" for run in lost]
    more = (
        f"; and {len(reported) - MAX_REPORTED} more, see spiral-ends.csv"
        if len(reported) > MAX_REPORTED
        else ""
    )
    return (
        f"{len(lost)} of {len(here)} spirals on {NETWORKS[network].name} were not driven to the end: "
        f"{'; '.join(reported[:MAX_REPORTED])}{more}."
    )


def _run(repetition: int, pair: Mapping[str, Any]) -> Run:
    return Run(
        network=pair["network"],
        repetition=repetition,
        pair=pair["pair"],
        failure=pair["failure"],
        sent_ms=pair["sent_ms"],
        arrived_ms=pair["arrived_ms"],
        end=None if pair["end"] is None else Pose(*pair["end"]),
        steps=pair["steps"],
        travelled_m=pair["travelled_m"],
        path=[(x, y) for x, y in pair["way"]],
    )
