"""Keeps a command within the robot's limits: speed, turn, steering, and how fast they may grow.

Braking is never limited: no command leaves here faster than it came, and one that asks for less speed than the
robot has in that direction passes at once. Pure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from robotether_agent.guard.commands import STANDSTILL, Command, Vector

# After a pause the robot may not make up for it at once.
MAX_STEP_S = 0.1


@dataclass(frozen=True)
class Limits:
    """None is no limit."""

    max_speed_m_s: float | None = None
    max_turn_rad_s: float | None = None
    max_acceleration_m_s2: float | None = None
    max_turn_acceleration_rad_s2: float | None = None
    max_steering_rad: float | None = None


def limited(command: Command, before: Command | None, step_s: float, limits: Limits) -> Command:
    """Return `command` within `limits`, `step_s` after `before`; None: the robot stands."""
    step_s = min(max(step_s, 0.0), MAX_STEP_S)
    linear, angular = (before.linear, before.angular) if before else (STANDSTILL, STANDSTILL)
    return replace(
        command,
        linear=_vector(
            command.linear, linear, limits.max_speed_m_s, limits.max_acceleration_m_s2, step_s
        ),
        angular=_vector(
            command.angular,
            angular,
            limits.max_turn_rad_s,
            limits.max_turn_acceleration_rad_s2,
            step_s,
        ),
        steering=_scalar(command.steering, limits.max_steering_rad),
    )


def _vector(
    wanted: Vector, before: Vector, most: float | None, growth: float | None, step_s: float
) -> Vector:
    length = math.hypot(*wanted)
    allowed = length if most is None else min(length, most)
    if growth is not None and length > 0:
        allowed = min(allowed, _along(before, wanted, length) + growth * step_s)
    return wanted if allowed >= length else _scaled(wanted, allowed / length)


def _along(before: Vector, wanted: Vector, length: float) -> float:
    """Return how fast the robot is in the wanted direction already; the other way counts as standing."""
    return max(0.0, sum(old * (new / length) for old, new in zip(before, wanted, strict=True)))


def _scaled(vector: Vector, factor: float) -> Vector:
    x, y, z = vector
    return (x * factor, y * factor, z * factor)


def _scalar(value: float, most: float | None) -> float:
    return value if most is None else max(-most, min(most, value))
