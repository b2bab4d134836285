"""How fast a robot may move by what its driver sees: the older that is, the slower. Pure.

The guard never lets a robot move further than a given length, or turn further than a given angle, in the time in which
its driver has not seen what it does: speed times age stays within it at each command that goes out. What is unknown
counts as MAX_SEEN_S old.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from robotether_common.guard import MAX_SEEN_S

# Time in which the age that limits the speed falls by half; it rises at once.
HALVED_IN_S = 0.25
# Minimum age, below what any camera brings; no number is divided by less.
MIN_AGE_S = 0.001
# Part of a limit that rounding may not exceed.
ROUNDED = 1 - 1e-9


@dataclass(frozen=True)
class BlindLimits:
    """The length and the angle that the robot may move unseen; None: no limit."""

    blind_m: float | None = None
    blind_rad: float | None = None
    # Delay of the camera before its frames have a timestamp.
    camera_s: float = 0.0
    # Whether a client that names no frames is limited, too.
    needs_frames: bool = False

    @property
    def any(self) -> bool:
        """Whether there is a limit at all."""
        return self.blind_m is not None or self.blind_rad is not None

    def speed(self, age_s: float) -> float:
        """Return the greatest speed in m/s for what is this old."""
        return self._within(self.blind_m, age_s)

    def turn(self, age_s: float) -> float:
        """Return the greatest turn in rad/s for what is this old."""
        return self._within(self.blind_rad, age_s)

    def _within(self, most: float | None, age_s: float) -> float:
        if most is None:
            return math.inf
        return most / max(age_s + self.camera_s, MIN_AGE_S) * ROUNDED


class LimitingAge:
    """The age by which one driver is limited: never less than the true one, and without a step down: no speed jumps."""

    def __init__(self) -> None:
        self._age_s = 0.0
        self._at = 0.0

    def at(self, age_s: float | None, now: float) -> float:
        """Return the age that counts `now`, when what the driver saw is so old; None: unknown."""
        fallen_s = self._age_s * 0.5 ** (max(0.0, now - self._at) / HALVED_IN_S)
        self._age_s = max(MAX_SEEN_S if age_s is None else age_s, fallen_s)
        self._at = now
        return self._age_s
