"""How many spirals are driven, over which networks, and how much of the spiral."""

from __future__ import annotations

from dataclasses import dataclass, replace

from sim_robot.kinematics import Velocity

from paper.profiles import FIXED, SLOW_4G
from paper.spiral_course import INTERVAL_S, velocities, velocities_within
from paper.step import Scale

# Round trips of 38 ± 20 ms.
JITTERY_4G = replace(SLOW_4G, name=f"{SLOW_4G.name}, 20 ms of jitter", jitter_ms=20)
# By their short names.
NETWORKS = {"fixed": FIXED, "4g": SLOW_4G, "4g-jitter": JITTERY_4G}
# Those of which the paper has a figure.
PAPERS = ("fixed", "4g")
PAPER_SIGMA_X_M, PAPER_SIGMA_Y_M = 0.001, 0.004
# What a quick run has time for.
QUICK_S = 20.0


@dataclass(frozen=True)
class Drive:
    """What runs at the same time: one repetition, over these networks."""

    name: str
    repetition: int
    networks: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is driven."""

    # On each network, all at the same time.
    pairs: int
    repetitions: int
    # Whether all networks are driven over at the same time, too, or one after the other.
    networks_at_once: bool
    # One an interval; whether that is the whole spiral.
    wanted: tuple[Velocity, ...]
    is_whole: bool

    @property
    def runs(self) -> int:
        """Spirals on each network."""
        return self.pairs * self.repetitions

    @property
    def duration_s(self) -> float:
        """How long one drive takes."""
        return len(self.wanted) * INTERVAL_S

    @property
    def drives(self) -> list[Drive]:
        """Each repetition's, in order."""
        numbers = range(1, self.repetitions + 1)
        if self.networks_at_once:
            return [Drive(f"repetition-{number:02}", number, tuple(NETWORKS)) for number in numbers]
        return [
            Drive(f"repetition-{number:02}-{network}", number, (network,))
            for number in numbers
            for network in NETWORKS
        ]


def plan_of(scale: Scale) -> Plan:
    """The paper's five pairs ten times, or one of each network once and the spiral's beginning.

    Five robots with everything around them take half of one core, fifteen leave too little of two for exact times.
    """
    if scale.quick:
        return Plan(
            pairs=1,
            repetitions=1,
            networks_at_once=True,
            wanted=velocities_within(QUICK_S),
            is_whole=False,
        )
    return Plan(pairs=5, repetitions=10, networks_at_once=False, wanted=velocities(), is_whole=True)
