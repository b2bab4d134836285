"""Keeps the mark of motion true: on the disk before a topic moves, away when the robot has stood for a while.

Used by the drive controller alone. What the mark says of a topic must be what the next guard needs to zero it.
"""

from __future__ import annotations

import logging
from collections.abc import Container, Iterable

from robotether_agent.guard.motion_state import Driven, MotionFile
from robotether_agent.problems import StateUnusable

# A driver's clean stop is often followed by the next motion; the mark need not be written for each.
REMOVED_AFTER_S = 1.0

log = logging.getLogger(__name__)


class MotionTracker:
    """The mark of one drive controller."""

    def __init__(self, file: MotionFile) -> None:
        self._file = file
        # What stands in the file.
        self._recorded: dict[str, Driven] = {}
        self._remove_at = 0.0

    @property
    def ends_at(self) -> float | None:
        """When the mark of a robot that stands is taken away; None: there is none."""
        return self._remove_at if self._recorded else None

    def left(self) -> list[Driven] | None:
        """Return what the last guard left: None nothing, an empty list something unknown."""
        return self._file.read()

    def adopt(self, driven: Iterable[Driven]) -> None:
        """Keep what the last guard left as this one's own."""
        self._recorded = {one.topic: one for one in driven}

    def ensure(self, moving: Driven, known: Container[str]) -> bool:
        """Write that a topic moves, before it does; False: it cannot. Others that are not `known` are left out."""
        if self._recorded.get(moving.topic) == moving:
            return True
        kept = {name: one for name, one in self._recorded.items() if name in known}
        recorded = {**kept, moving.topic: moving}
        try:
            self._file.write(list(recorded.values()))
        except StateUnusable as problem:
            log.error("%s", problem)  # noqa: TRY400 - no defect
            return False
        self._recorded = recorded
        return True

    def tend(self, now: float, *, moves: bool) -> None:
        """Take the mark away when the robot has stood for a while."""
        if moves or not self._recorded:
            self._remove_at = now + REMOVED_AFTER_S
        elif now >= self._remove_at:
            self.end(now)

    def end(self, now: float) -> None:
        """Take the mark away: the robot stands. Another guard's mark, which this one never took over, stays."""
        if not self._recorded:
            return
        try:
            self._file.remove()
            self._recorded = {}
        except StateUnusable as problem:
            log.warning("%s", problem)
            self._remove_at = now + REMOVED_AFTER_S
