"""How many spirals are driven, over which networks, and how much of the spiral."""

from __future__ import annotations

from dataclasses import dataclass, replace

from sim_robot.kinematics import Velocity

from paper.profiles import FIXED, SLOW_4G, Profile
from paper.spiral_course import INTERVAL_S, velocities, velocities_within
from paper.step import Scale

# Round trips of 38 ± 20 ms.
JITTERY_4G = replace(SLOW_4G, name=f"{SLOW_4G.name}, 20 ms of jitter", jitter_ms=20)
# In one repetition all of them are driven over at the same time; by their short names.
NETWORKS = {"fixed": FIXED, "4g": SLOW_4G, "4g-jitter": JITTERY_4G}
# Those of which the paper has a figure.
PAPERS = ("fixed", "4g")
PAPER_SIGMA_X_M, PAPER_SIGMA_Y_M = 0.001, 0.004
# What a quick run has time for.
QUICK_S = 20.0


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is driven."""

    # On each network, all at the same time.
    pairs: int
    repetitions: int
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
    def names(self) -> list[str]:
        """The repetitions' names, in order."""
        return [f"repetition-{number:02}" for number in range(1, self.repetitions + 1)]


def plan_of(scale: Scale) -> Plan:
    """The paper's five pairs ten times, or one of each network once and the spiral's beginning."""
    if scale.quick:
        return Plan(pairs=1, repetitions=1, wanted=velocities_within(QUICK_S), is_whole=False)
    return Plan(pairs=5, repetitions=10, wanted=velocities(), is_whole=True)


def profile_of(network: str) -> Profile:
    """The network of this short name."""
    return NETWORKS[network]
