"""Decides when an operator's connection is slow or silent. Pure: no network, no clock of its own.

`rosbridge` feeds it twice a second with what the sockets show, so that a message costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["ok", "client_silent", "client_slow", "robot_slow"]


@dataclass(frozen=True)
class LivenessLimits:
    """Seconds after which the other side counts as silent or slow."""

    ping_every_s: float = 2.0
    silent_after_s: float = 6.0
    slow_after_s: float = 10.0
    check_every_s: float = 0.5
    # A driver of whom nothing comes holds the lease no longer, whatever waits to be sent to it.
    strict: bool = False


DRIVER_LIMITS = LivenessLimits(ping_every_s=0.2, silent_after_s=2.5, check_every_s=0.1, strict=True)


class Drain:
    """Watches one direction: how long a filled send buffer has not moved."""

    def __init__(self, now: float) -> None:
        self._moved_at = now
        self._left = 0

    def update(self, now: float, written: int, buffered: int) -> None:
        """Take the bytes ever handed to the socket, and those of them still waiting."""
        left = written - buffered
        if buffered == 0 or left != self._left:
            self._moved_at = now
        self._left = left

    def stuck_for_s(self, now: float) -> float:
        """Tell for how long nothing has moved; 0 when nothing waits."""
        return now - self._moved_at


class Liveness:
    """Judges one connection from its two send buffers and the time it was last heard."""

    def __init__(self, limits: LivenessLimits, now: float) -> None:
        self._limits = limits
        self._to_client = Drain(now)
        self._to_robot = Drain(now)
        self._excused_at = now

    def check(
        self,
        now: float,
        *,
        received_at: float,
        to_client: tuple[int, int],
        to_robot: tuple[int, int],
    ) -> Verdict:
        """Judge at `now`; the tuples are (bytes written, bytes waiting) of each direction."""
        self._to_client.update(now, *to_client)
        self._to_robot.update(now, *to_robot)
        if self._to_client.stuck_for_s(now) > self._limits.slow_after_s:
            return "client_slow"
        if self._to_robot.stuck_for_s(now) > self._limits.slow_after_s:
            return "robot_slow"
        # Behind data that waits, a ping cannot arrive; and while the robot's side is full,
        # the client is not read, so its pongs are not seen. Neither is the client's silence.
        if to_robot[1] or (to_client[1] and not self._limits.strict):
            self._excused_at = now
        if now - max(received_at, self._excused_at) > self._limits.silent_after_s:
            return "client_silent"
        return "ok"
