"""One run of numbered messages over pairs of an operator and a robot: two load generators, and what they cost.

Used by high_rate.py. The operators' ends are in one process and the robots' in another, so that neither
keeps the other waiting; both tell their share of a core, and this module that of the whole machine, so that a reader
sees whether the generator or the machine was the limit.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from paper.costs import machine_cpu_s, trees_cpu_s, use_of
from paper.numbered.messages import joined
from paper.numbered.worker import SILENCE_S, End
from paper.programs import LineProgram
from paper.robots import WholeRobot

if TYPE_CHECKING:
    from paper.networks import Uplink
    from paper.world import World

# Twice what the worker gives a connection, and some more.
READY_WITHIN_S = 70.0
# How many times longer than planned senders may take, and how much more.
TIMEOUT_FACTOR, MORE_S = 3.0, 20.0
# What the last messages may need behind the silence that ends a run, and the answer itself.
MORE_THAN_SILENCE_S = 30.0
BEGINS_IN_NS = 200_000_000
# Those that a message passes.
SERVICES = ("nginx", "relay", "sshd")
# The relay lets one user have 32 connections; one that has ended may still count.
PAIRS_A_USER = 25
USER = "x-numbered"


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is sent: so many messages a pair at a rate, to the robot or from it."""

    count: int
    rate_hz: float
    to_robot: bool = True

    @property
    def planned_s(self) -> float:
        return self.count / self.rate_hz

    @property
    def at_most_s(self) -> float:
        return self.planned_s * TIMEOUT_FACTOR + MORE_S + READY_WITHIN_S


def run(
    world: World, operators: Uplink, robots: Sequence[WholeRobot], plan: Plan
) -> dict[str, Any]:
    """Send the messages of a plan between all robots and an operator of each, and return what became of them.

    The operators are behind one uplink, and the robots behind another.
    """
    with tokens(world, len(robots)) as given, ExitStack() as stack:
        outside = [
            _end(
                number, plan, sends=plan.to_robot, site=world.address, token=token, robot=item.name
            )
            for number, (item, token) in enumerate(zip(robots, given, strict=True))
        ]
        # Clients of the robots' own rosbridges.
        inside = [
            _end(number, plan, sends=not plan.to_robot, url=item.ros_url)
            for number, item in enumerate(robots)
        ]
        sides = [(operators, outside), (robots[0].uplink, inside)]
        senders, receivers = sides if plan.to_robot else sides[::-1]
        receiving = stack.enter_context(_generator(world, "receivers", *receivers))
        sending = stack.enter_context(_generator(world, "senders", *senders))
        for item in (receiving, sending):
            item.receive("that all are connected", READY_WITHIN_S)
        before = _used(world, robots)
        sending.send({"begin_ns": time.monotonic_ns() + BEGINS_IN_NS})
        sending_s = sending.receive("that all was sent", plan.at_most_s)["sending_s"]
        receiving.send({"sent": True})
        received = receiving.receive("what came", plan.at_most_s + SILENCE_S + MORE_THAN_SILENCE_S)
        sending.send({"end": True})
        sent = sending.receive("what was sent", READY_WITHIN_S)
        used = {name: value - before[name] for name, value in _used(world, robots).items()}
    return {
        "pairs": len(robots),
        **asdict(plan),
        "planned_s": plan.planned_s,
        "sending_s": sending_s,
        "took_s": used.pop("took"),
        # Seconds of processor time; "machine" is all that it did, by whomever.
        "cpu_s": {**used, "senders": sent["cpu_s"], "receivers": received["cpu_s"]},
        "cores": os.cpu_count(),
        **joined(sent["ends"], received["ends"]),
    }


@contextmanager
def tokens(world: World, how_many: int) -> Iterator[list[str]]:
    """An API token for each operator: the world's own for as many as one user may be, then those of more users."""
    names = [f"{USER}-{os.getpid()}-{at}" for at in range(PAIRS_A_USER, how_many, PAIRS_A_USER)]
    given = [world.token]
    with ExitStack() as made:
        for name in names:
            given.append(world.add_admin(name))
            made.callback(world.api, "DELETE", f"/users/{name}")
        yield [given[number // PAIRS_A_USER] for number in range(how_many)]


def _end(number: int, plan: Plan, **where: Any) -> End:
    return End(pair=number, count=plan.count, rate_hz=plan.rate_hz, **where)


def _generator(world: World, name: str, uplink: Uplink, ends: Sequence[End]) -> LineProgram:
    program = LineProgram("paper.numbered.worker", world.folder / f"{name}.log")
    program.send({"namespace": uplink.inside.name, "ends": [asdict(end) for end in ends]})
    return program


def _used(world: World, robots: Sequence[WholeRobot]) -> dict[str, float]:
    """Seconds of this clock, and of processor time by who used it, until now."""
    roots = [pid for robot in robots for pid in (robot.agent_pid, robot.ros_pid)]
    return {
        **{name: use_of(world.container(name)).cpu_s for name in SERVICES},
        "robots": sum(trees_cpu_s(roots)),
        # One behind the other, as a share is made of them, and reading may take long where there is much to do.
        "took": time.monotonic(),
        "machine": machine_cpu_s(),
    }
