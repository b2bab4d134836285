"""The age of what a driver sees, and the speed limit that follows: the older, the slower.

The agent reports each frame to the guard as it sends it, and each drive command names the frames that were on the
driver's screens. Both times are on the robot's clock, so the age contains camera, screen, hand and way back. A frame
that the guard does not know counts as MAX_SEEN_S old, never as young.

The guard never lets a robot move further than a given length, or turn further than a given angle, in the time in which
its driver has not seen what it does: speed times age stays within it at each command that goes out. Pure: times in
seconds are given.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from robotether_common.guard import MAX_FRAMES, MAX_SEEN_FRAMES, MAX_SEEN_S, MAX_SLOWED_S

# Maximum number of cameras whose frames are remembered.
MAX_CAMERAS = 16
# Maximum number of ages in one report.
MAX_AGES = 64
# Time in which the age that limits the speed falls by half; it rises at once.
HALVED_IN_S = 0.25
# Minimum age, below what any camera brings; no number is divided by less.
MIN_AGE_S = 0.001
# Part of a limit that rounding may not exceed.
ROUNDED = 1 - 1e-9


class FrameTimes:
    """When the frames that left the robot in the last MAX_SEEN_S were taken, by camera and number."""

    def __init__(self) -> None:
        # The camera whose frame came last is the last one.
        self._cameras: dict[str, dict[int, float]] = {}

    def note(self, camera: str, frame: int, taken_s: float, now: float) -> None:
        """Note a frame that leaves the robot now; of two with one number the older counts."""
        frames = self._cameras[camera] = self._cameras.pop(camera, {})
        taken_s = min(taken_s, now, frames.pop(frame, now))
        frames[frame] = taken_s
        while len(frames) > MAX_FRAMES or now - next(iter(frames.values())) > MAX_SEEN_S:
            del frames[next(iter(frames))]
            if not frames:
                break
        if len(self._cameras) > MAX_CAMERAS:
            del self._cameras[next(iter(self._cameras))]

    def oldest_s(self, seen: object, now: float) -> float | None:
        """Return when the oldest frame of a stamp's `seen` was taken; None: one is unknown, or there is none."""
        if not isinstance(seen, list) or not 0 < len(seen) <= MAX_SEEN_FRAMES:
            return None
        times = [self._taken_s(view, now) for view in seen]
        return None if None in times else min(taken_s for taken_s in times if taken_s is not None)

    def may_follow(self, seen: object, now: float) -> bool:
        """Return whether the agent's next line may report what is unknown in a stamp's `seen`."""
        if not isinstance(seen, list) or not seen or self.oldest_s(seen, now) is not None:
            return False
        # The server names what it did not send as null.
        return all(isinstance(view, dict) and type(view.get("frame")) is int for view in seen)

    def _taken_s(self, view: object, now: float) -> float | None:
        if not isinstance(view, dict):
            return None
        camera, frame = view.get("camera"), view.get("frame")
        # True is a number to Python only.
        if not isinstance(camera, str) or type(frame) is not int:
            return None
        taken_s = self._cameras.get(camera, {}).get(frame)
        return None if taken_s is None or now - taken_s > MAX_SEEN_S else taken_s


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


@dataclass
class DriverView:
    """What the guard knows of one connection's driver, beside the frames of a command."""

    # Whether a command has named frames.
    names_frames: bool = False
    limiting_age: LimitingAge = field(default_factory=LimitingAge)


@dataclass(frozen=True)
class SeenFrames:
    """What a driver saw at a command: when the oldest frame on the screens was taken; None: unknown."""

    taken_s: float | None
    view: DriverView
    # Of the driver's lease; 0: none.
    fence: int

    def age_s(self, now: float) -> float | None:
        """Return how old it is now; None: unknown."""
        return None if self.taken_s is None else max(0.0, now - self.taken_s)

    def limiting_age_s(self, now: float) -> float:
        """Return the age by which the driver's commands are limited now."""
        return self.view.limiting_age.at(self.age_s(now), now)


class SeenAges:
    """The ages of one drive's commands that the agent has not been told yet, in ms, and how they were slowed.

    An age of None is unknown. `slowed_s` is the time for which a command was slowed, `limits` the greatest speed and
    turn of the newest command that was; None: the newest was not.
    """

    def __init__(self) -> None:
        self.fence = 0
        self.ages_ms: list[float | None] = []
        self.slowed_s = 0.0
        self.limits: tuple[float, float] | None = None

    @property
    def has_news(self) -> bool:
        """Whether there is something to report: the relay takes nothing of what moves without a lease."""
        return self.fence > 0 and (bool(self.ages_ms) or self.slowed_s > 0)

    def report(self) -> dict[str, object]:
        """Return the members of the report."""
        speed, turn = self.limits or (math.inf, math.inf)
        return {
            "fence": self.fence,
            "ages_ms": self.ages_ms,
            "slowed_s": round(min(self.slowed_s, MAX_SLOWED_S), 3),
            "max_speed_m_s": round(speed, 4) if math.isfinite(speed) else None,
            "max_turn_rad_s": round(turn, 4) if math.isfinite(turn) else None,
        }

    def clear(self) -> None:
        """Forget what was reported."""
        self.ages_ms, self.slowed_s = [], 0.0

    def begin(self, fence: int) -> None:
        """Forget another drive's; without a lease there is none."""
        if fence != self.fence:
            self.fence, self.limits = fence, None
            self.clear()

    def add(self, age_s: float | None) -> None:
        """Add the age of a command that was sent."""
        age_ms = None if age_s is None else round(age_s * 1000, 1)
        if len(self.ages_ms) < MAX_AGES:
            self.ages_ms.append(age_ms)
            return
        # More commands than are reported: the greatest age must not get lost.
        last_ms = self.ages_ms[-1]
        if last_ms is not None and (age_ms is None or age_ms > last_ms):
            self.ages_ms[-1] = age_ms
