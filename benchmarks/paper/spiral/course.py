"""The paper's spiral and how often it is driven: the commands, their ideal way, and turtlesim's steps. Pure.

Frame: that of the robot when it starts: metres, x ahead, y to the left; theta in radians, counter-clockwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

from sim_robot.kinematics import STANDING, STEP_S, Pose, Turtle, Velocity

from paper.networks import FIXED, SLOW_4G
from paper.step import Scale

RATE_HZ = 2.0
INTERVAL_S = 1 / RATE_HZ
FIRST_SPEED_M_S, SPEED_STEP_M_S, TURN_RAD_S = 1.0, 0.05, 1.0
LENGTH_M = 78.275
# Sums of speeds are exact to far less than this.
ROUNDING_M = 1e-6
START = Pose(0.0, 0.0, 0.0)
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
class Change:
    """From `at_s` on the robot is told this velocity."""

    at_s: float
    velocity: Velocity


def velocities(length_m: float = LENGTH_M) -> tuple[Velocity, ...]:
    """One an interval, the next a little faster, until together they command at least this length."""
    speeds: list[float] = []
    while sum(speeds) * INTERVAL_S < length_m - ROUNDING_M:
        speeds.append(FIRST_SPEED_M_S + SPEED_STEP_M_S * len(speeds))
    return tuple(Velocity(speed, 0.0, TURN_RAD_S) for speed in speeds)


def velocities_within(seconds: float) -> tuple[Velocity, ...]:
    """Those of the whole spiral that end within this time."""
    return velocities()[: int(seconds * RATE_HZ)]


def commanded_m(wanted: Sequence[Velocity]) -> float:
    """How far the robot is told to go."""
    return sum(each.linear_x for each in wanted) * INTERVAL_S


def punctual(wanted: Sequence[Velocity]) -> list[Change]:
    """The commands at exact intervals, and the standstill after the last."""
    return [Change(n * INTERVAL_S, each) for n, each in enumerate([*wanted, STANDING])]


def along(pose: Pose, velocity: Velocity, seconds: float) -> Pose:
    """Where a robot is that keeps this velocity so long: a straight line or an arc, in closed form."""
    speed, turn = velocity.linear_x, velocity.angular_z
    theta = pose.theta + turn * seconds
    if turn == 0:
        path = speed * seconds
        return Pose(pose.x + path * math.cos(theta), pose.y + path * math.sin(theta), theta)
    radius = speed / turn
    return Pose(
        pose.x + radius * (math.sin(theta) - math.sin(pose.theta)),
        pose.y - radius * (math.cos(theta) - math.cos(pose.theta)),
        theta,
    )


def end_of(changes: Sequence[Change]) -> Pose:
    """Where a robot stands that follows at once and exactly; the last change has to stop it."""
    pose = START
    for change, following in pairwise(changes):
        pose = along(pose, change.velocity, following.at_s - change.at_s)
    return pose


def stepped_end(changes: Sequence[Change], phase_s: float) -> Pose:
    """Where turtlesim's kinematics end: they take a change at their next step, the first of which is at `phase_s`."""
    turtle, number = Turtle(2 * commanded_m([each.velocity for each in changes]) + 1), 0
    start = turtle.pose
    for change in changes:
        while (now_s := phase_s + number * STEP_S) < change.at_s:
            turtle.step(now_s)
            number += 1
        turtle.command(change.velocity, now_s)
    return in_frame_of(start, turtle.pose)


@cache
def stepped_ends(wanted: tuple[Velocity, ...], phases: int = 160) -> tuple[Pose, ...]:
    """All that turtlesim can make of exactly punctual commands: the ends for so many phases, evenly over a step."""
    changes = punctual(wanted)
    return tuple(stepped_end(changes, n * STEP_S / phases) for n in range(phases))


def in_frame_of(start: Pose, pose: Pose) -> Pose:
    """The pose as a robot at `start` sees it."""
    east, north = pose.x - start.x, pose.y - start.y
    cos, sin = math.cos(start.theta), math.sin(start.theta)
    return Pose(cos * east + sin * north, cos * north - sin * east, pose.theta - start.theta)


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
        return self.pairs * self.repetitions

    @property
    def duration_s(self) -> float:
        return len(self.wanted) * INTERVAL_S

    @property
    def drives(self) -> list[Drive]:
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
