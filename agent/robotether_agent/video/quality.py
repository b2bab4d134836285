"""Steps quality, size and rate, so that frames arrive in the requested time; pure, each timestamp is an argument.

Smooth keeps the rate: quality goes down first, then size. Sharp lowers the rate first.

Down quickly: to what a full line carries, or after LATE_FRAMES late ones, by two steps when they are very late, or when
clearly fewer go out than come in. Up slowly: after seconds in which all came well within, and ever later when the last
way up led down again. A step down for the rate that brought no more frames is taken back: the round trip limits them,
and not their size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from robotether_common.frames import StreamRequest

QUALITY_STEP = 10
SCALES = (0.75, 0.5, 0.35)
# Parts of the requested rate for receivers that prefer sharp frames, and the minimum rate in frames a second.
RATES, MIN_STEPPED_FPS = (0.67, 0.5, 0.33), 5.0
LATE_FRAMES = 3
VERY_LATE = 2.0
# Part of the requested latency that leaves room for a step up.
WELL_WITHIN = 0.6
UP_AFTER_S, MAX_UP_AFTER_S = 4.0, 60.0
# Time after a step up in which a step down shows that the step up was wrong.
REGRET_S = 10.0
# Time without a step down after which steps up are quick again.
CALM_S = 120.0
# Minimum part of the offered frames that must leave, number of checks in a row below it that mean too
# few, and minimum number of offered frames.
FEW, FEW_LOOKS, FEW_OFFERED = 0.8, 3, 3
GAIN = 1.1
TRIED_S = 3.0
NO_RATE_STEPS_S = 30.0
# Number of checks in a row that must find too much for the full line, as a stall is over soon; and the time for which
# the line is taken to carry no more.
FULL_LOOKS, LINE_KNOWN_S = 4, 10.0


@dataclass(frozen=True)
class Level:
    """JPEG quality, and the parts of the wanted size and rate."""

    quality: int
    scale: float = 1.0
    rate: float = 1.0


def ladder(stream_request: StreamRequest, *, scales: bool) -> tuple[Level, ...]:
    """Return all levels from the best down; the size only goes after the quality is at its least."""
    best, least = stream_request.quality_max, stream_request.quality_min
    is_sharp = stream_request.prefers == "sharp"
    rates = [r for r in RATES if is_sharp and stream_request.fps * r >= MIN_STEPPED_FPS]
    rate = rates[-1] if rates else 1.0
    qualities = [*range(best - QUALITY_STEP, least, -QUALITY_STEP), *[least] * (least < best)]
    return (
        Level(best),
        *(Level(best, rate=rate) for rate in rates),
        *(Level(quality, rate=rate) for quality in qualities),
        *(Level(least, scale, rate) for scale in SCALES if scales),
    )


@dataclass(frozen=True)
class _Trial:
    """A step down for the rate: what went out before it, and when it is judged."""

    rate: float
    until_s: float
    level: Level


class Steps:
    """Which level is in force; it gets each frame that has arrived and, once a second, the rates."""

    def __init__(self, levels: tuple[Level, ...], latency_s: float, now_s: float) -> None:
        self._levels = levels
        self._latency_s = latency_s
        self._at = 0
        self._late = 0
        self._few = 0
        self._good_since_s = now_s
        self._up_after_s = UP_AFTER_S
        self._up_at_s = self._down_at_s = now_s - CALM_S
        self._trial: _Trial | None = None
        self._no_rate_steps_until_s = now_s
        # Nothing is known of a stall: the first check counts.
        self._full = FULL_LOOKS - 1
        self._carries: Callable[[Level], bool] = lambda _: True
        self._line_known_until_s = now_s

    @property
    def level(self) -> Level:
        """The level in force."""
        return self._levels[self._at]

    def use(self, levels: tuple[Level, ...], latency_s: float, now_s: float) -> None:
        """Go on with other levels, at the best that is no better than the one before."""
        before = self.level
        self._levels = levels
        self._latency_s = latency_s
        fitting = (
            at
            for at, level in enumerate(levels)
            if level.quality <= before.quality
            and level.scale <= before.scale
            and level.rate <= before.rate
        )
        self._at = next(fitting, len(levels) - 1)
        self._trial = None
        self._begin(now_s)

    def on_taken(self, now_s: float, took_s: float) -> bool:
        """A frame of this level took `took_s` to be taken; return whether the level changed."""
        if took_s > self._latency_s:
            self._good_since_s = now_s
            very = took_s > VERY_LATE * self._latency_s
            self._late += 2 if very else 1
            return self._late >= LATE_FRAMES and self._down(now_s, 2 if very else 1)
        self._late = 0
        if took_s > WELL_WITHIN * self._latency_s:
            self._good_since_s = now_s
        return now_s - self._good_since_s >= self._up_after_s and self._up(now_s)

    def on_full_line(self, now_s: float, carries: Callable[[Level], bool]) -> bool:
        """Go down to a quality that the full line carries; called four times a second. Return whether that is now."""
        self._carries, self._line_known_until_s = carries, now_s + LINE_KNOWN_S
        whole = [at for at, level in enumerate(self._levels) if level.scale == 1]
        at = next((at for at in whole if carries(self._levels[at])), whole[-1])
        self._full = self._full + 1 if at > self._at else 0
        return self._full >= FULL_LOOKS and self._down(now_s, at - self._at)

    def on_rates(self, now_s: float, offered: float, sent: float) -> bool:
        """Judge the rates of offered and sent frames; return whether the level changed."""
        if self._trial is not None:
            return now_s >= self._trial.until_s and self._judge(now_s, sent)
        if offered < FEW_OFFERED or sent >= FEW * offered:
            self._few = 0
            return False
        self._good_since_s = now_s
        self._few += 1
        if self._few < FEW_LOOKS or now_s < self._no_rate_steps_until_s:
            return False
        before = self.level
        if not self._down(now_s, 1):
            return False
        if self.level.rate < before.rate:
            # It brings no more frames, but those that come sooner.
            return True
        self._trial = _Trial(sent, now_s + TRIED_S, before)
        return True

    def _judge(self, now_s: float, sent: float) -> bool:
        """Take a step for the rate back that brought nothing."""
        trial, self._trial = self._trial, None
        if trial is None or sent >= GAIN * trial.rate:
            return False
        self._no_rate_steps_until_s = now_s + NO_RATE_STEPS_S
        self._at = self._levels.index(trial.level)
        self._begin(now_s)
        return True

    def _down(self, now_s: float, steps: int) -> bool:
        self._trial = None
        to = min(self._at + steps, len(self._levels) - 1)
        changed = to != self._at
        if changed and now_s - self._up_at_s < REGRET_S:
            self._up_after_s = min(MAX_UP_AFTER_S, 2 * self._up_after_s)
        self._at = to
        self._down_at_s = now_s
        self._begin(now_s)
        return changed

    def _up(self, now_s: float) -> bool:
        if self._at == 0 or self._is_over_line(now_s, self._levels[self._at - 1]):
            self._good_since_s = now_s
            return False
        if now_s - self._down_at_s >= CALM_S:
            self._up_after_s = UP_AFTER_S
        self._at -= 1
        self._up_at_s = now_s
        self._trial = None
        self._begin(now_s)
        return True

    def _is_over_line(self, now_s: float, level: Level) -> bool:
        return now_s < self._line_known_until_s and not self._carries(level)

    def _begin(self, now_s: float) -> None:
        self._late = self._few = self._full = 0
        self._good_since_s = now_s
