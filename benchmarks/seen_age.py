"""How old what a driver sees is when the robot obeys, and how right the guard's own word for it is. Used by `bench`.

A program views a robot as a page does, and names a frame in each command; the guard's age comes back on its connection.
Needs root, and `measure` also `make demo`. The robot moves some millimetres.
"""

from __future__ import annotations

import asyncio
import random
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import aiohttp
from bare_tunnel import bare_forward
from demo import Demo
from link import Link, Shape
from linked_robot import (
    DOWN,
    SMALL_CAMERA,
    UP,
    UP_MBIT_S,
    VIDEO_PORT,
    WIDE_CAMERA,
    Address,
    Site,
    Subject,
    emulated,
    emulated_links,
    linked_robot,
    linked_robots,
)
from local_network import free_port, insecure_tls
from relay_server import until
from report import Row, Section, quantiles
from video import (
    CAMERA,
    CODECS_VIEWED,
    FAST_CAMERA,
    PLAIN_QUALITIES,
    STARTS_WITHIN_S,
    Frame,
    OnFrame,
    demo_address,
    frames_row,
    frames_url,
    plain_viewed,
    shape_of,
    until_seen,
    view_frames,
)
from video import NETWORKS as PAPERS_NETWORKS

SECONDS = 60.0
OPERATORS, OPERATED_S = 3, 20.0
# Interval between commands: the guard reports twice a second, so that each report is of one command.
COMMAND_EVERY_S = 0.7
REPORTED_WITHIN_S = 3.0
# Time in which the connection gets the lease and has pings answered, from which a command's age counts.
SETTLE_S = 3.0
SPEED_M_S = 0.01
# Number of the last frames of which each command names one.
FRAMES = 10
# The drawn clock has tenths of a ms, and so has the reported age.
ROUNDED_MS = 0.2
AIM_MS = 10.0
# Of the loop.
AIM_P50_MS, AIM_P99_MS = 90, 150
FAR = Shape(rate_bit_s=5e6, delay_s=0.1, queue_bytes=UP.queue_bytes)
# Up and down.
NETWORKS = {f"38 ms, {UP_MBIT_S} Mbit/s up": (UP, DOWN), "200 ms, 5 Mbit/s": (FAR, FAR)}


@dataclass(frozen=True)
class Seen:
    """The age of a frame in ms when a command that names it was sent, and as the guard measured it."""

    sent_ms: float
    guards_ms: float
    codec: str


@dataclass(frozen=True)
class DriverView:
    """What a driver views; it may drive by the newest frame, or name any of the last ones."""

    stream_request: Mapping[str, Any]
    camera: str = CAMERA
    by_newest: bool = False


class Driver:
    """A connection that drives; it reads all the time, as the age of a command counts from an answered ping."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse, camera: str) -> None:
        self._socket, self._camera = socket, camera
        self._answers: asyncio.Queue[dict[str, Any]] = asyncio.Queue()

    async def read(self) -> None:
        # Who sends one gets what the relay says itself.
        await self._socket.send_json({"op": "robotether.clock_sync", "t_ms": 0})
        async for message in self._socket:
            answer = message.json()
            if answer.get("op") in {"robotether.seen", "status"}:
                self._answers.put_nowait(answer)
        raise ConnectionError(f"the drive ended with {self._socket.close_code}")

    async def command(self, frame: Frame, speed: float) -> Seen:
        """Send one command that names this frame, and wait for the guard's age."""
        stamp = {"seen": [{"camera": self._camera, "frame": frame.sequence}]}
        message = {"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": speed}}}
        sent_at = time.time()
        await self._socket.send_json({**message, "robotether": stamp})
        answer = await asyncio.wait_for(self._answers.get(), REPORTED_WITHIN_S)
        if answer["op"] == "status":
            raise RuntimeError(f"cannot measure: {answer.get('msg')}")
        if answer["age_ms"] is None:
            raise RuntimeError("cannot measure: the guard does not know the frame")
        return Seen((sent_at - frame.drawn_at) * 1000, answer["age_ms"], frame.codec.name)


async def drive(
    driver: Driver, frames: Sequence[Frame], seconds: float, view: DriverView
) -> list[Seen]:
    """Drive for so long, to and fro, with a frame of the last ones at each command."""
    chance, seen = random.Random(1), list[Seen]()
    await asyncio.sleep(SETTLE_S)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        speed = SPEED_M_S * (-1) ** len(seen)
        frame = frames[-1] if view.by_newest else chance.choice(frames)
        seen.append(await driver.command(frame, speed))
        await asyncio.sleep(COMMAND_EVERY_S)
    return seen


async def run(
    address: Address,
    seconds: float,
    view: DriverView,
    on_frame: OnFrame = lambda _: None,
    **how: Any,
) -> list[Seen]:
    """Have somebody drive who views the robot's camera; `how` goes to ws_connect."""
    url = frames_url(address, view.camera)
    frames = deque[Frame](maxlen=FRAMES)

    def note(frame: Frame) -> None:
        frames.append(frame)
        on_frame(frame)

    async with aiohttp.ClientSession() as http, asyncio.TaskGroup() as group:
        viewing = group.create_task(view_frames(http, note, url, view.stream_request, **how))
        await until(lambda: len(frames) == FRAMES, f"{FRAMES} frames", STARTS_WITHIN_S)
        async with http.ws_connect(address("ros?", "drive"), compress=0, **how) as socket:
            driver = Driver(socket, view.camera)
            reading = group.create_task(driver.read())
            seen = await drive(driver, frames, seconds, view)
            for task in (viewing, reading):
                task.cancel()
        return seen


async def run_behind(
    link: Link,
    seconds: float,
    views: Sequence[DriverView],
    camera: Mapping[str, int] = SMALL_CAMERA,
) -> list[list[Seen]]:
    async with linked_robot(link, camera) as (site, subject):
        address = site.address_of(subject.robot)
        await until_seen(
            lambda http, on_frame: view_frames(http, on_frame, frames_url(address, CAMERA))
        )
        return [await run(address, seconds, view) for view in views]


def row(where: str, seen: list[Seen], delay_ms: float = 0.0) -> Row:
    errors = [command.guards_ms - command.sent_ms - delay_ms for command in seen]
    (age_ms,) = quantiles([command.sent_ms for command in seen], 0.5, unit="ms").values()
    named = quantiles(errors, 0, 0.5, 0.99, 1, unit="ms")
    return {
        "where": where,
        # Of the frames that came, whatever was requested.
        "codec": ", ".join(sorted({command.codec for command in seen})),
        "commands": len(seen),
        "age when sent, p50, ms": age_ms,
        **{f"error, {name}": value for name, value in named.items()},
        "too young": sum(error < -ROUNDED_MS for error in errors),
        "over the aim": sum(error > AIM_MS for error in errors),
    }


def measure(demo: Demo, seconds: float = SECONDS) -> Section:
    address = demo_address(demo)
    views = [DriverView({"codecs": [codec]}) for codec in CODECS_VIEWED]
    rows = [
        row("loopback", asyncio.run(run(address, seconds, view, ssl=insecure_tls())))
        for view in views
    ]
    for name, (up, down) in NETWORKS.items():
        with emulated(up, down) as link:
            by_codec = asyncio.run(run_behind(link, seconds, views))
        rows += [row(name, seen, down.delay_s * 1000) for seen in by_codec]
    text = (
        f"A program names one of the last {FRAMES} frames in each command. The error is the age that the robot's guard "
        "reports, less the frame's age by the clock drawn into it when the command was sent, and less the network's "
        "delay. The rest of the command's way to the guard is part of the error.\n\n"
        f"Aim: never too young, and at most {AIM_MS:g} ms too old on loopback."
    )
    return Section("Error of the age of what a driver sees", text, rows)


def loop_row(view: DriverView, seen: list[Seen]) -> Row:
    return {
        "camera": view.camera,
        "codec": ", ".join(sorted({command.codec for command in seen})),
        "commands": len(seen),
        **quantiles([command.guards_ms for command in seen], 0.5, 0.95, 0.99, unit="ms"),
    }


def measure_loop(seconds: float = SECONDS) -> Section:
    views = [
        DriverView({**WIDE_CAMERA, "codecs": [codec]}, camera, by_newest=True)
        for camera in (CAMERA, FAST_CAMERA)
        for codec in CODECS_VIEWED
    ]
    with emulated() as link:
        loops = asyncio.run(run_behind(link, seconds, views, WIDE_CAMERA))
    camera = "a camera of {width}x{height} at {fps} frames a second".format_map(WIDE_CAMERA)
    text = (
        "From the capture of the newest frame that a driver has to the command at the robot's guard: 38 ms, "
        f"{UP_MBIT_S} Mbit/s up, {camera}. The age is the guard's own. Drawing, encoding, the decoding of H.264 and "
        "the pause between frames are included, the screen is not. "
        f"{FAST_CAMERA} turns fast and has noise.\n\n"
        f"Aim: p50 {AIM_P50_MS} ms and p99 {AIM_P99_MS} ms by H.264."
    )
    rows = [loop_row(*pair) for pair in zip(views, loops, strict=True)]
    return Section("From a frame to the command that it leads to", text, rows)


async def operate(
    addresses: Sequence[Address], subjects: Sequence[Subject], seconds: float, view: DriverView
) -> Row:
    """Have each robot driven by an operator of its own, all at once; frames of the last `seconds` count."""
    seen: list[list[Frame]] = [[] for _ in addresses]
    began_s, robots_s, server_s = time.monotonic(), cpu_s(subjects), time.process_time()
    pairs = zip(addresses, seen, strict=True)
    loops = await asyncio.gather(*(run(each, seconds, view, own.append) for each, own in pairs))
    used = {
        "agent, % of a core": (cpu_s(subjects) - robots_s) / len(subjects),
        "relay and operators, % of a core": time.process_time() - server_s,
    }
    from_s, lasted_s = time.time() - seconds, time.monotonic() - began_s
    frames = [[frame for frame in own if frame.received_at >= from_s] for own in seen]
    ages_ms = [command.guards_ms for loop in loops for command in loop]
    return {
        # In a thread: the relay, in this process, has heartbeats to answer.
        **await asyncio.to_thread(frames_row, frames, seconds),
        **{f"loop {name}": ms for name, ms in quantiles(ages_ms, 0.5, 0.99, unit="ms").items()},
        **{name: used_s / lasted_s * 100 for name, used_s in used.items()},
    }


def cpu_s(subjects: Sequence[Subject]) -> float:
    return sum(subject.cpu_s() for subject in subjects)


async def plain(links: Sequence[Link], site: Site, where: str, seconds: float, camera: str) -> Row:
    """What the operators see by plain MJPEG, through a bare `ssh -R` a robot, all at once."""
    with ExitStack() as stack:
        ports = [free_port() for _ in links]
        for number, (link, port) in enumerate(zip(links, ports, strict=True), len(links) + 1):
            to, host = {port: f"127.0.0.1:{VIDEO_PORT}"}, site.sshd.address
            stack.enter_context(bare_forward(site.sshd, number, to, host=host, inside=link.robot))
        return await plain_viewed(where, ports, PLAIN_QUALITIES[1], seconds, camera)


async def operators_on(links: Sequence[Link], where: str, seconds: float) -> list[Row]:
    rows: list[Row] = []
    async with linked_robots(links) as (site, subjects):
        for subject in subjects:
            await subject.until_drivable()
        addresses = [site.address_of(subject.robot) for subject in subjects]
        for camera in (CAMERA, FAST_CAMERA):
            for codec in CODECS_VIEWED:
                view = DriverView({"codecs": [codec]}, camera, by_newest=True)
                row = await operate(addresses, subjects, seconds, view)
                rows.append({"where": where, "camera": camera, "route": "Robotether", **row})
            rows.append(await plain(links, site, where, seconds, camera))
    return rows


def measure_operators(
    seconds: float = OPERATED_S, networks: Sequence[tuple[float, float, float]] = PAPERS_NETWORKS
) -> Section:
    rows: list[Row] = []
    for down, up, delay_ms in networks:
        shapes = shape_of(up, delay_ms), shape_of(down, delay_ms)
        with emulated_links(OPERATORS, *shapes) as links:
            where = f"{down:g}/{up:g} Mbit/s, {delay_ms:g} ms"
            rows += asyncio.run(operators_on(links, where, seconds))
    text = (
        f"Each of {OPERATORS} operators drives a robot by the newest frame of its camera, all at once, {seconds:g} s a "
        "row: 640x480 at 15 frames a second, and a network of its own for each robot. Frames are of all, rates of one. "
        "The loop is from a frame's capture to the command at the guard, by the guard. Beside plain MJPEG nobody "
        "drives. An agent's processor time includes its encoder; relay, operators and their decoders are one "
        "process.\n\nAim: on no network older than plain MJPEG."
    )
    return Section("Three operators at once on the paper's networks", text, rows)
