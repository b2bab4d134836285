"""What the guard tells its agent, one JSON object a line on standard output.

Used by the guard's process. An agent that does not read must not hold the guard up: beyond the pipe's size and a
bound, lines are dropped, and the agent ends a guard that it does not hear. A driver must not be able to make more lines
than the server takes of a robot, which would end its session.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from robotether_agent.fields import line_of
from robotether_agent.guard.refused import Kind

MAX_QUEUE_BYTES = 16 * 1024
MOTION_EVERY_S = 0.1
COUNTS_EVERY_S = 1.0


@dataclass(frozen=True)
class State:
    """What is told when it changes."""

    stopped: bool
    by: str
    moving: bool


class Reports:
    """The lines to the agent."""

    def __init__(
        self, pipe: asyncio.WriteTransport, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._pipe = pipe
        self._clock = clock
        self._sent: State | None = None
        self._sent_refused: Mapping[Kind, int] = {}
        self._sent_at = 0.0

    def ready(self, port: int) -> None:
        """Tell where the guard listens."""
        self._line({"type": "ready", "port": port})

    def tick(self) -> None:
        """Tell that the guard lives."""
        self._line({"type": "tick"})

    def state(
        self, state: State, refused: Mapping[Kind, int], *, answers: str | None = None
    ) -> None:
        """Tell the state if it or `refused` is another than was sent last, or if it `answers` a stop or a release.

        Call it now and then also when nothing changed: counts and the end of a short motion may be told later.
        """
        if answers is None and self._can_wait(state, refused):
            return
        sent = {"stopped": state.stopped, "by": state.by, "moving": state.moving}
        line = {
            "type": "guard",
            "state": "ready",
            **sent,
            "answers": answers,
            "refused": dict(refused),
        }
        if self._line(line):
            self._sent, self._sent_at = state, self._clock()
            self._sent_refused = dict(refused)

    def _can_wait(self, state: State, refused: Mapping[Kind, int]) -> bool:
        sent, since_s = self._sent, self._clock() - self._sent_at
        if state == sent:
            return refused == self._sent_refused or since_s < COUNTS_EVERY_S
        if state.moving or sent is None or (sent.stopped, sent.by) != (state.stopped, state.by):
            return False
        return since_s < MOTION_EVERY_S

    def _line(self, fields: Mapping[str, object]) -> bool:
        if self._pipe.is_closing() or self._pipe.get_write_buffer_size() > MAX_QUEUE_BYTES:
            return False
        self._pipe.write(line_of(fields))
        return True
