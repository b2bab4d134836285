"""Experiment 4, the spiral: robots are driven along it without looking; where they end shows how well they were led.

The paper's five pairs end within 0.001 m in x and 0.004 m in y. Operators are programs in this process, each with a
connection of its own; robots are watched by watch.py in another.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Mapping, Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass
from functools import partial
from typing import Any

import aiohttp
from sim_robot.kinematics import STANDING, Pose, Velocity

from paper.client import FAILURES, Client, new_http
from paper.networks import Uplink, made_in
from paper.programs import LineProgram
from paper.robots import WholeRobot, running, wait_all_online
from paper.spiral.course import INTERVAL_S, NETWORKS, Drive, Plan, in_frame_of, plan_of
from paper.spiral.report import report
from paper.spiral.watch import BEGINS_WITHIN_S, CMD_VEL, POSE, STANDS_WITHIN_S, TYPES
from paper.step import Part, Scale, Step, Values
from paper.world import World

# Between two commands lies half a second, in which the guard's usual time is over.
SETTINGS = {"guard": {"deadman_ms": 1000}}
ONLINE_WITHIN_S, CONNECTED_WITHIN_S = 90.0, 20.0
# Until then everybody is ready; what an answer of the watching process may take beyond what it waits for.
LEAD_S, ANSWER_S = 0.3, 5.0
MS = 1e6


@dataclass(frozen=True)
class Pair:
    """A robot, and the uplink that its operator is behind."""

    network: str
    number: int
    robot: WholeRobot
    uplink: Uplink


class Driver:
    """An operator's program that publishes what it was given, when it is time, and looks at nothing."""

    def __init__(self, world: World, pair: Pair) -> None:
        self._world = world
        self._pair = pair
        self._socket: aiohttp.ClientWebSocketResponse
        # time.monotonic_ns() of each command.
        self.sent_ns: list[int] = []
        self.problem = ""

    async def connect(self, opened: AsyncExitStack) -> None:
        """Open the connection, which `opened` will end, and wait until the robot's pose comes through it."""
        try:
            async with asyncio.timeout(CONNECTED_WITHIN_S):
                await self._connect(opened)
        except (*FAILURES, TypeError) as error:
            self.problem = f"the operator could not connect: {type(error).__name__}: {error}"

    async def drive(self, wanted: Sequence[Velocity], start_s: float) -> None:
        """Send one command an interval from `begin_s` (time.monotonic()) on, then the standstill."""
        if self.problem:
            return
        try:
            for number, velocity in enumerate([*wanted, STANDING]):
                await asyncio.sleep(start_s + number * INTERVAL_S - time.monotonic())
                text = twist(velocity)
                self.sent_ns.append(time.monotonic_ns())
                await self._socket.send_str(text)
        except (OSError, aiohttp.ClientError) as error:
            lost = f"the operator could not send command {len(self.sent_ns)}: {error}"
            self.problem = self.problem or lost

    async def _connect(self, opened: AsyncExitStack) -> None:
        http = await opened.enter_async_context(new_http(**made_in(self._pair.uplink.inside)))
        client = Client(http, self._world.address, self._world.token, CONNECTED_WITHIN_S)
        socket = await opened.enter_async_context(await client.connect(self._pair.robot.name))
        self._socket = socket
        await socket.send_json({"op": "advertise", "topic": CMD_VEL, "type": TYPES[CMD_VEL]})
        # As often as it drives: somebody who drives sees something of the robot.
        every_ms = round(INTERVAL_S * 1000)
        await socket.send_json({"op": "subscribe", "topic": POSE, "throttle_rate": every_ms})
        while (message := await socket.receive_json())["op"] != "publish":
            if message["op"] == "status":
                raise ConnectionError(f"{self._pair.robot.name} says: {message}")
        reading = asyncio.create_task(self._read())
        opened.push_async_callback(_end, reading)

    async def _read(self) -> None:
        """Take what comes, which answers pings, too; remember why it ends."""
        async for _ in self._socket:
            pass
        self.problem = self.problem or f"the connection ended: {self._socket.close_code}"


def drive(world: World, plan: Plan, what: Drive) -> Values:
    """Start the robots, drive them all, and tell what each pair did; a pair's failure does not fail the others."""
    everywhere = [network for network in what.networks for _ in range(plan.pairs)]
    wanted_uplinks = [NETWORKS[network] for network in (*what.networks, *everywhere)]
    enrolled = world.enrol(world.names("spiral", len(everywhere)), SETTINGS)
    try:
        with world.uplinks(wanted_uplinks) as made:
            operators = dict(zip(what.networks, made, strict=False))
            behind = zip(enrolled, made[len(what.networks) :], strict=True)
            with running(
                [WholeRobot(world, one, uplink, "simulator") for one, uplink in behind]
            ) as robots:
                wait_all_online(robots, ONLINE_WITHIN_S)
                pairs = [
                    Pair(network, number % plan.pairs + 1, robot, operators[network])
                    for number, (network, robot) in enumerate(zip(everywhere, robots, strict=True))
                ]
                reported = asyncio.run(_drive_all(world, pairs, plan.wanted))
                return {"repetition": what.repetition, "pairs": reported}
    finally:
        world.remove(enrolled)


def twist(velocity: Velocity) -> str:
    linear = {"x": velocity.linear_x, "y": velocity.linear_y, "z": 0.0}
    angular = {"x": 0.0, "y": 0.0, "z": velocity.angular_z}
    message = {"linear": linear, "angular": angular}
    return json.dumps({"op": "publish", "topic": CMD_VEL, "msg": message})


async def _drive_all(
    world: World, pairs: Sequence[Pair], wanted: Sequence[Velocity]
) -> list[Values]:
    drivers = [Driver(world, pair) for pair in pairs]
    async with AsyncExitStack() as opened:
        watcher = LineProgram("paper.spiral.watch", world.folder / "watch.log")
        opened.callback(watcher.close)
        robots = [pair.robot for pair in pairs]
        watcher.send([{"namespace": one.uplink.inside.name, "url": one.ros_url} for one in robots])
        await asyncio.to_thread(watcher.receive, "that all are watched", BEGINS_WITHIN_S + ANSWER_S)
        await asyncio.gather(*(driver.connect(opened) for driver in drivers))
        start_s = time.monotonic() + LEAD_S
        # People are not in step: their moments lie evenly within an interval.
        await asyncio.gather(
            *(
                driver.drive(wanted, start_s + INTERVAL_S * number / len(drivers))
                for number, driver in enumerate(drivers)
            )
        )
        watcher.send("finish")
        records = await asyncio.to_thread(
            watcher.receive, "what the robots did", STANDS_WITHIN_S + ANSWER_S
        )
    return [
        outcome(pair, driver.sent_ns, driver.problem, record, wanted)
        for pair, driver, record in zip(pairs, drivers, records, strict=True)
    ]


async def _end(task: asyncio.Task[None]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


def outcome(
    pair: Pair,
    sent_ns: Sequence[int],
    problem: str,
    record: Mapping[str, Any],
    wanted: Sequence[Velocity],
) -> Values:
    """What the results keep of one pair: times in ms from the first sending, poses as seen from the robot's start."""
    start = None if record["start"] is None else Pose(*record["start"])
    first_ns = sent_ns[0] if sent_ns else 0
    return {
        "network": pair.network,
        "pair": pair.number,
        "failure": failure(problem, record, wanted),
        "sent_ms": [round((at - first_ns) / MS, 3) for at in sent_ns],
        "arrived_ms": [round((at - first_ns) / MS, 3) for at, _, _ in record["arrived"]],
        "end": _seen(start, record["end"]),
        "steps": record["steps"],
        "travelled_m": round(record["travelled_m"], 6),
    }


def failure(problem: str, record: Mapping[str, Any], wanted: Sequence[Velocity]) -> str:
    """Why this run was not driven to its end; empty when the robot got each command once and in order, and stands."""
    if why := problem or record["problem"]:
        return why
    expected = [(each.linear_x, each.angular_z) for each in (*wanted, STANDING)]
    arrived = [(speed, turn) for _, speed, turn in record["arrived"]]
    for number, (right, got) in enumerate(zip(expected, arrived, strict=False), 1):
        if got != right:
            what = "was stopped" if got == (0.0, 0.0) else f"got {got}"
            return f"the robot {what} in place of command {number} of {len(expected)}"
    if len(arrived) != len(expected):
        return f"the robot got {len(arrived)} of {len(expected)} commands"
    return "" if record["stands"] else "the robot does not stand after the last command"


def _seen(start: Pose | None, pose: Sequence[float] | None) -> list[float] | None:
    if start is None or pose is None:
        return None
    seen = in_frame_of(start, Pose(*pose))
    return [round(part, 6) for part in (seen.x, seen.y, seen.theta)]


def steps(scale: Scale) -> Sequence[Step]:
    """One for all that are driven at the same time."""
    plan = plan_of(scale)
    return [_step(plan, each) for each in plan.drives]


def _step(plan: Plan, each: Drive) -> Step:
    robots = plan.pairs * len(each.networks)
    where = ", ".join(NETWORKS[network].name for network in each.networks)
    return Step(
        name=each.name,
        title=f"{robots} spirals at once, {where}, repetition {each.repetition} of {plan.repetitions}",
        run=partial(drive, plan=plan, what=each),
    )


PART = Part(
    name="spiral",
    title="Open-loop spiral",
    steps=steps,
    report=lambda scale, results: report(plan_of(scale), results),
)
