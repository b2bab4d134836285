"""One run of the operators' experiment: each operator looks at a robot's camera and drives it, all at once.

With each command to the wheels goes a numbered text that says when it was due, and which is noted at the robot's own
rosbridge, behind the guard: a twist has no room for either. Operators, and those who take notes at the robots, are one
process with one clock; what this process itself is late counts as latency. The samples themselves are kept, so that a
percentile is that of all robots together and not a mean of percentiles.
"""

from __future__ import annotations

import asyncio
import io
import itertools
import json
import os
import statistics
import time
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import aiohttp
from frame_stamp import read_stamp
from PIL import Image
from video_viewers import Frame, OnFrame

from paper.costs import machine_cpu_s, trees_cpu_s
from paper.networks import TABLE_2, Profile
from paper.numbered.messages import TOPIC, TYPE, publish
from paper.step import Values

QUALITIES = (90, 80, 70, 60, 50)
# The range of qualities that a viewer has who asks for nothing else (docs/reference/media.md); in place of a quality.
ADAPTIVE = None
OURS, PLAIN = "ours", "plain"
ROBOTS, FPS = 3, 15
_NAMES = ("fixed-94", "fixed-288", "4g-7", "4g-31", "4g-80", "4g-5")
NETWORKS: Mapping[str, Profile] = dict(zip(_NAMES, TABLE_2, strict=True))
CMD_VEL, TWIST = "/cmd_vel", "geometry_msgs/Twist"
TYPES = {CMD_VEL: TWIST, TOPIC: TYPE}
# A circle of half a metre, so that the robot never meets a wall.
TURN = {
    "op": "publish",
    "topic": CMD_VEL,
    "msg": {"linear": {"x": 0.3, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.6}},
}
COMMANDS_HZ = 20
STARTS_WITHIN_S = 30.0
# What has not come then is lost.
LAST_S = 3.0
POLL_S = 0.02
# Numbers of frames begin anew then.
NUMBERS = 1 << 32
NS_A_S, NS_A_MS = 1_000_000_000, 1e6
# Looks at the robot's camera until it is cancelled.
View = Callable[[OnFrame], Coroutine[Any, Any, None]]


def step_name(network: str, quality: int | None) -> str:
    """The step of a network, by its short name, and a quality; "4g-7-q90" or "4g-7-adaptive"."""
    return f"{network}-adaptive" if quality is ADAPTIVE else f"{network}-q{quality}"


@dataclass(frozen=True, kw_only=True)
class Times:
    """How long a run is: until whatever fills up has filled up, and then what is measured."""

    settle_s: float
    measure_s: float


@dataclass(frozen=True, kw_only=True)
class OperatorClient:
    """What one operator has of a robot, whichever way it is connected."""

    robot: str
    view: View
    # The operator's rosbridge connection, and one at the robot itself.
    rosbridge: aiohttp.ClientWebSocketResponse
    subscriber: aiohttp.ClientWebSocketResponse
    # One who looks at the robot itself, where the operator's frames do not tell how many there were.
    local_view: View | None
    simulator_pid: int


@dataclass
class Notes:
    """What came, as it came, of one robot; moments are time.monotonic_ns() but for those of frames."""

    pictures: list[Frame] = field(default_factory=list)
    # The moments of the onlooker's frames.
    local_frames_s: list[float] = field(default_factory=list)
    due_ns: list[int] = field(default_factory=list)
    # When it was due, and when it came.
    commands_ns: list[tuple[int, int]] = field(default_factory=list)
    driven_ns: list[int] = field(default_factory=list)
    refused_ns: list[int] = field(default_factory=list)


@dataclass(frozen=True)
class Mark:
    """A moment by both clocks, with what had been used by then."""

    unix_s: float
    ns: int
    # Processor time of all cores, and of each robot's simulator.
    machine_cpu_s: float
    simulators_cpu_s: Sequence[float]


async def measured(clients: Sequence[OperatorClient], times: Times) -> Values:
    """Drive and look from all seats; each must see its first frame in time, and none may lose its connection."""
    notes = [Notes() for _ in clients]
    tasks = [
        asyncio.create_task(job)
        for pair in zip(clients, notes, strict=True)
        for job in _jobs(*pair)
    ]
    try:
        if not await _until(tasks, lambda: all(one.pictures for one in notes), STARTS_WITHIN_S):
            blind = [
                client.robot for client, one in zip(clients, notes, strict=True) if not one.pictures
            ]
            raise TimeoutError(f"no frame of {', '.join(blind)} in {STARTS_WITHIN_S:g} s")
        await _hold(tasks, times.settle_s)
        start = _mark(clients)
        await _hold(tasks, times.measure_s)
        end = _mark(clients)
        # With all going on as before.
        await _until(tasks, lambda: _have_come(notes, end), LAST_S)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    return await asyncio.to_thread(_run, notes, start, end)


def _jobs(client: OperatorClient, notes: Notes) -> list[Coroutine[Any, Any, None]]:
    jobs = [_drive(client, notes), _read(client, notes), _note(client, notes)]
    jobs.append(client.view(notes.pictures.append))
    if client.local_view is not None:
        jobs.append(client.local_view(lambda frame: notes.local_frames_s.append(frame.received_at)))
    return jobs


async def _drive(client: OperatorClient, notes: Notes) -> None:
    """Send commands at their times, whatever becomes of those before."""
    for topic, kind in TYPES.items():
        await client.rosbridge.send_json({"op": "advertise", "topic": topic, "type": kind})
    turn, began = json.dumps(TURN), time.monotonic_ns()
    for number in itertools.count():
        due_ns = began + number * NS_A_S // COMMANDS_HZ
        await asyncio.sleep((due_ns - time.monotonic_ns()) / NS_A_S)
        notes.due_ns.append(due_ns)
        await client.rosbridge.send_str(turn)
        await client.rosbridge.send_str(publish(0, number, due_ns))


async def _read(client: OperatorClient, notes: Notes) -> None:
    """Take what comes to the operator: what was refused, as a command that came too late."""
    async for message in client.rosbridge:
        if json.loads(message.data).get("op") == "status":
            notes.refused_ns.append(time.monotonic_ns())
    raise ConnectionError(
        f"the connection of the operator of {client.robot} ended: {client.rosbridge.close_code}"
    )


async def _note(client: OperatorClient, notes: Notes) -> None:
    for topic, kind in TYPES.items():
        await client.subscriber.send_json({"op": "subscribe", "topic": topic, "type": kind})
    async for message in client.subscriber:
        received_ns, said = time.monotonic_ns(), json.loads(message.data)
        if said.get("op") != "publish":
            raise RuntimeError(f"the rosbridge of {client.robot} says {said}")
        if said["topic"] == CMD_VEL:
            notes.driven_ns.append(received_ns)
        else:
            notes.commands_ns.append((int(said["msg"]["data"].split()[-1]), received_ns))
    raise ConnectionError(f"the rosbridge of {client.robot} ended the connection")


async def _hold(tasks: Sequence[asyncio.Task[None]], seconds: float) -> None:
    """Wait so long; none of the tasks may end meanwhile."""
    done, _ = await asyncio.wait(tasks, timeout=seconds, return_when=asyncio.FIRST_COMPLETED)
    for task in done:
        task.result()


async def _until(
    tasks: Sequence[asyncio.Task[None]], condition: Callable[[], bool], seconds: float
) -> bool:
    """Wait until it holds, at most so long; whether it came to that."""
    end_s = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end_s:
            return False
        await _hold(tasks, POLL_S)
    return True


def _have_come(notes: Sequence[Notes], end: Mark) -> bool:
    """Whether all commands that were due by then have come."""
    due = [{due for due in one.due_ns if due < end.ns} for one in notes]
    received = [{due for due, _ in one.commands_ns} for one in notes]
    return all(wanted <= there for wanted, there in zip(due, received, strict=True))


def _mark(clients: Sequence[OperatorClient]) -> Mark:
    return Mark(
        unix_s=time.time(),
        ns=time.monotonic_ns(),
        machine_cpu_s=machine_cpu_s(),
        simulators_cpu_s=trees_cpu_s(client.simulator_pid for client in clients),
    )


def _run(notes: Sequence[Notes], start: Mark, end: Mark) -> Values:
    """What was noted between two marks; reads the moment out of each frame, which takes a while."""
    lasted_s = (end.ns - start.ns) / NS_A_S
    used_s = end.machine_cpu_s - start.machine_cpu_s
    return {
        "lasted_s": lasted_s,
        # The share of this machine's processors that was at work. The kernel counts in whole ticks, so that a full
        # machine may seem a little more than full.
        "busy": min(1.0, used_s / (lasted_s * (os.cpu_count() or 1))),
        "robots": [_seen(one, number, start, end) for number, one in enumerate(notes)],
    }


def _seen(notes: Notes, number: int, start: Mark, end: Mark) -> Values:
    """One robot; times are in ms from the beginning of what is measured."""
    lasted_s = (end.ns - start.ns) / NS_A_S
    pictures = [one for one in notes.pictures if start.unix_s <= one.received_at < end.unix_s]
    asked = [one.quality for one in pictures if one.quality is not None]
    received = {due: (at - due) / NS_A_MS for due, at in reversed(notes.commands_ns)}
    used = (end.simulators_cpu_s[number] - start.simulators_cpu_s[number]) / lasted_s
    return {
        # When each was whole at the operator, bytes, age in ms.
        "pictures": [
            (round((one.received_at - start.unix_s) * 1000, 2), len(one.jpeg), round(one.age_ms, 2))
            for one in pictures
        ],
        "camera_fps": camera_fps(pictures, notes.local_frames_s, start.unix_s, end.unix_s),
        # The means of what was asked of the camera, and of the frames' widths; None without any.
        "quality": statistics.fmean(asked) if asked else None,
        "width_px": statistics.fmean(map(width_px, pictures)) if pictures else None,
        # From the scheduled moment until it was at the robot's rosbridge; None: never came.
        "commands_ms": [
            round(received[due], 2) if due in received else None
            for due in notes.due_ns
            if start.ns <= due < end.ns
        ],
        # When commands to the wheels came there.
        "driven_ms": [
            round((at - start.ns) / NS_A_MS, 2) for at in notes.driven_ns if start.ns <= at < end.ns
        ],
        # How often the operator was told that a command was refused: for the guard, one over 0.5 s old.
        "refused": sum(start.ns <= at < end.ns for at in notes.refused_ns),
        # Of one core, 1 for all of it.
        "simulator_cpu": used,
    }


def camera_fps(
    pictures: Sequence[Frame], local_frames_s: Sequence[float], since_s: float, until_s: float
) -> float | None:
    """What the camera gave a second: by the numbers of what came, else by who looks at the robot itself."""
    numbered_ones = [one for one in pictures if one.number is not None]
    if not numbered_ones:
        seen = sum(since_s <= at_s < until_s for at_s in local_frames_s)
        return seen / (until_s - since_s) if local_frames_s else None
    first, last = numbered_ones[0], numbered_ones[-1]
    # By the moments that they show: how long each was on its way is not the camera's.
    lasted_s = read_stamp(last.jpeg) - read_stamp(first.jpeg)
    assert first.number is not None
    assert last.number is not None
    return (last.number - first.number) % NUMBERS / lasted_s if lasted_s > 0 else None


def width_px(frame: Frame) -> int:
    """How wide it is, which is less than what was asked for where a link was too narrow."""
    with Image.open(io.BytesIO(frame.jpeg)) as opened:
        return opened.width
