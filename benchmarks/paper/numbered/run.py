"""One run of numbered messages over pairs of an operator and a robot: two load generators, and what they cost.

Used by high_rate.py and mixed.py. The operators' ends are in one process and the robots' in another, so that neither
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

from openssh_server import command_line, descendants

from paper.costs import machine_cpu_s, trees_cpu_s, use_of
from paper.numbered.messages import FRAME_BYTES, joined
from paper.numbered.worker import MORE_S, SILENCE_S, TIMEOUT_FACTOR, End
from paper.programs import LineProgram
from paper.robots import WholeRobot
from paper.step import Values

if TYPE_CHECKING:
    from paper.networks import Uplink
    from paper.world import World

# Twice what the worker gives a connection, and some more.
READY_WITHIN_S = 70.0
# What the last messages may need behind the silence that ends a run, and the answer itself.
MORE_THAN_SILENCE_S = 30.0
BEGINS_IN_NS = 200_000_000
# Those that a message passes.
SERVICES = ("nginx", "relay", "sshd")
# The relay lets one user have 32 connections; one that has ended may still count.
PAIRS_A_USER = 25
USER = "x-numbered"
LINK_WORKER = "link_worker.py"


@dataclass(frozen=True)
class Pair:
    """An operator behind an uplink, and the robot of that operator."""

    operator: Uplink
    robot: WholeRobot


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


def run(world: World, pairs: Sequence[Pair], plan: Plan) -> dict[str, Any]:
    """Send the messages of a plan between all pairs at once, and return what became of them."""
    with tokens(world, len(pairs)) as given:
        operators = [
            operator_end(world, pair, number, plan, given[number])
            for number, pair in enumerate(pairs)
        ]
        robots = [robot_end(pair, number, plan) for number, pair in enumerate(pairs)]
        return _run(world, pairs, plan, operators, robots)


def _run(
    world: World, pairs: Sequence[Pair], plan: Plan, operators: Sequence[End], robots: Sequence[End]
) -> dict[str, Any]:
    senders, receivers = (operators, robots) if plan.to_robot else (robots, operators)
    with (
        _generator(world, receivers, "receivers") as receiving,
        _generator(world, senders, "senders") as sending,
    ):
        for one in (receiving, sending):
            one.receive("that all are connected", READY_WITHIN_S)
        before = _used(world, pairs)
        sending.send({"begin_ns": time.monotonic_ns() + BEGINS_IN_NS})
        sending_s = sending.receive("that all was sent", plan.at_most_s)["sending_s"]
        receiving.send({"sent": True})
        received = receiving.receive("what came", plan.at_most_s + SILENCE_S + MORE_THAN_SILENCE_S)
        sending.send({"end": True})
        sent = sending.receive("what was sent", READY_WITHIN_S)
        used = {name: value - before[name] for name, value in _used(world, pairs).items()}
    return {
        "pairs": len(pairs),
        **asdict(plan),
        "frame_bytes": FRAME_BYTES,
        "planned_s": plan.planned_s,
        "sending_s": sending_s,
        "took_s": used.pop("took"),
        # Seconds of processor time; "machine" is all that it did, by whomever.
        "cpu_s": {**used, "senders": sent["cpu_s"], "receivers": received["cpu_s"]},
        "cores": os.cpu_count(),
        **joined(sent["ends"], received["ends"]),
        "networks": by_network(pairs, plan, sent["ends"], received["ends"]),
    }


def by_network(
    pairs: Sequence[Pair], plan: Plan, sent: Sequence[Values], received: Sequence[Values]
) -> dict[str, Any]:
    """The same of the pairs behind each kind of network, where there are several."""
    kinds: dict[str, set[int]] = {}
    for number, pair in enumerate(pairs):
        kinds.setdefault(pair.operator.profile.name, set()).add(number)
    if len(kinds) == 1:
        return {}
    return {
        kind: {
            "pairs": len(some),
            **asdict(plan),
            **joined(
                [one for one in sent if one["pair"] in some],
                [one for one in received if one["pair"] in some],
            ),
        }
        for kind, some in kinds.items()
    }


@contextmanager
def tokens(world: World, how_many: int) -> Iterator[list[str]]:
    """An API token for each operator: the world's own for as many as one user may be, then those of more users."""
    names = [f"{USER}-{os.getpid()}-{at}" for at in range(PAIRS_A_USER, how_many, PAIRS_A_USER)]
    given = [world.token]
    with ExitStack() as made:
        for name in names:
            world.api("POST", "/users", {"name": name, "role": "admin"})
            made.callback(world.api, "DELETE", f"/users/{name}")
            create = ("robotether", "token", "create", "--days", "1")
            printed = world.exec("web", *create, "--user", name, "--name", "numbered")
            given.append(printed.split()[-1])
        yield [given[number // PAIRS_A_USER] for number in range(how_many)]


def operator_end(world: World, pair: Pair, number: int, plan: Plan, token: str) -> End:
    """The end outside: through nginx, with tickets."""
    return End(
        pair=number,
        count=plan.count,
        rate_hz=plan.rate_hz,
        sends=plan.to_robot,
        namespace=pair.operator.inside.name,
        site=world.address,
        token=token,
        robot=pair.robot.name,
    )


def robot_end(pair: Pair, number: int, plan: Plan) -> End:
    """The end on the robot: a client of its own rosbridge."""
    return End(
        pair=number,
        count=plan.count,
        rate_hz=plan.rate_hz,
        sends=not plan.to_robot,
        namespace=pair.robot.uplink.inside.name,
        url=pair.robot.ros_url,
    )


@contextmanager
def _generator(world: World, ends: Sequence[End], name: str) -> Iterator[LineProgram]:
    one = LineProgram("paper.numbered.worker", world.folder / f"{name}.log")
    try:
        one.send({"ends": [asdict(end) for end in ends]})
        yield one
    finally:
        one.close()


def link_workers() -> list[int]:
    """The processes of this one that emulate networks."""
    return [pid for pid in descendants(os.getpid()) if LINK_WORKER in command_line(pid)]


def _used(world: World, pairs: Sequence[Pair]) -> dict[str, float]:
    """Seconds of this clock, and of processor time by who used it, until now."""
    roots = [pid for pair in pairs for pid in (pair.robot.agent_pid, pair.robot.ros_pid)]
    return {
        **{name: use_of(world.container(name)).cpu_s for name in SERVICES},
        "robots": sum(trees_cpu_s(roots)),
        "links": sum(trees_cpu_s(link_workers())),
        # One behind the other, as a share is made of them, and reading may take long where there is much to do.
        "took": time.monotonic(),
        "machine": machine_cpu_s(),
    }
