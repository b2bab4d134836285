"""What one run of the operators' experiment notes of each robot, and the figures that the page makes of it. Pure.

The samples themselves are kept, so that a percentile is that of all robots together and not a mean of percentiles.
"""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from sections import quantile


@dataclass(frozen=True, kw_only=True)
class Seen:
    """One robot in one run; times are in ms from the beginning of what is measured."""

    # When it was whole at the operator, bytes, age in ms.
    pictures: Sequence[tuple[float, int, float]]
    # What the camera gave a second at the robot, whoever got it; None where too little came to tell.
    camera_fps: float | None
    # The mean JPEG quality that was asked of the camera; None where only the stream's own address tells.
    quality: float | None
    # The pictures' mean width in pixels; None without any.
    width_px: float | None
    # From the scheduled moment until it was at the robot's rosbridge; None: never came.
    commands_ms: Sequence[float | None]
    # When commands to the wheels came there.
    driven_ms: Sequence[float]
    # How often the operator was told that a command was refused: for the guard, one over 0.5 s old.
    refused: int
    # Of one core, 1 for all of it.
    simulator_cpu: float
    agent_cpu: float


@dataclass(frozen=True, kw_only=True)
class Run:
    """One way, one network and one quality, with all robots at once."""

    lasted_s: float
    # The share of this machine's processors that was at work, 0 to 1.
    busy: float
    robots: Sequence[Seen]

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Run:
        """Read it back from the results."""
        robots = [
            Seen(**{**robot, "pictures": list(map(tuple, robot["pictures"]))})
            for robot in values["robots"]
        ]
        return cls(lasted_s=values["lasted_s"], busy=values["busy"], robots=robots)

    def as_values(self) -> dict[str, Any]:
        """What JSON can carry."""
        return asdict(self)

    @property
    def summary(self) -> Summary:
        """The figures of all robots together."""
        return summary(self.robots, self.lasted_s)


@dataclass(frozen=True, kw_only=True)
class Summary:
    """The figures of some robots; a rate is that of one robot, None is what nothing was measured of."""

    pictures_per_s: float
    camera_fps: float | None
    quality: float | None
    width_px: float | None
    picture_kb: float | None
    mbit_s: float
    delay_mean_ms: float | None
    delay_p95_ms: float | None
    age_p50_ms: float | None
    age_p95_ms: float | None
    commands: int
    # Commands that did not come while they were waited for; they are in no percentile.
    lost: int
    command_p50_ms: float | None
    command_p99_ms: float | None
    driven_per_s: float
    refused: int
    # The longest time without a command to the wheels.
    longest_pause_ms: float
    simulator_cpu: float
    agent_cpu: float


def summary(robots: Sequence[Seen], lasted_s: float) -> Summary:
    """Put the samples of some robots together."""
    ages = [age for robot in robots for _, _, age in robot.pictures]
    sizes = [size for robot in robots for _, size, _ in robot.pictures]
    delays = [delay for robot in robots for delay in delays_ms(robot)]
    sent = [latency for robot in robots for latency in robot.commands_ms]
    received = [latency for latency in sent if latency is not None]
    each = len(robots) * lasted_s
    return Summary(
        pictures_per_s=len(sizes) / each,
        camera_fps=_mean(robot.camera_fps for robot in robots),
        quality=_mean(robot.quality for robot in robots),
        width_px=_mean(robot.width_px for robot in robots),
        picture_kb=sum(sizes) / len(sizes) / 1000 if sizes else None,
        mbit_s=sum(sizes) * 8 / each / 1e6,
        delay_mean_ms=_mean(delays),
        delay_p95_ms=_quantile(delays, 0.95),
        age_p50_ms=_quantile(ages, 0.5),
        age_p95_ms=_quantile(ages, 0.95),
        commands=len(sent),
        lost=len(sent) - len(received),
        command_p50_ms=_quantile(received, 0.5),
        command_p99_ms=_quantile(received, 0.99),
        driven_per_s=sum(len(robot.driven_ms) for robot in robots) / each,
        refused=sum(robot.refused for robot in robots),
        longest_pause_ms=max(longest_pause_ms(robot.driven_ms, lasted_s) for robot in robots),
        simulator_cpu=statistics.fmean(robot.simulator_cpu for robot in robots),
        agent_cpu=statistics.fmean(robot.agent_cpu for robot in robots),
    )


def delays_ms(robot: Seen) -> Iterator[float]:
    """The time from each picture to the next, in ms."""
    for (before, *_), (after, *_) in itertools.pairwise(robot.pictures):
        yield after - before


def longest_pause_ms(moments_ms: Sequence[float], lasted_s: float) -> float:
    """The longest time in which nothing came, in ms; the beginning and the end count as moments."""
    edges = [0.0, *sorted(moments_ms), lasted_s * 1000]
    return max(after - before for before, after in itertools.pairwise(edges))


def _mean(values: Iterable[float | None]) -> float | None:
    """Of those that are known."""
    known = [value for value in values if value is not None]
    return statistics.fmean(known) if known else None


def _quantile(values: Sequence[float], part: float) -> float | None:
    return quantile(values, part) if values else None
