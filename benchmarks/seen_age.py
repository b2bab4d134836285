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
from dataclasses import dataclass
from typing import Any

import aiohttp
from demo import Demo
from link import Link, Shape
from linked_robot import DOWN, FPS, UP, UP_MBIT_S, Address, emulated, linked_robot
from local_network import insecure_tls
from relay_server import until
from report import Row, Section, quantiles
from video import (
    CAMERA,
    CODECS_VIEWED,
    FAST_CAMERA,
    STARTS_WITHIN_S,
    Frame,
    demo_address,
    frames_url,
    until_seen,
    view_frames,
)

SECONDS = 60.0
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
WIDTH, HEIGHT, CAMERA_FPS = 1280, 720, 25
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


async def run(address: Address, seconds: float, view: DriverView, **how: Any) -> list[Seen]:
    """Have somebody drive who views the robot's camera; `how` goes to ws_connect."""
    url = frames_url(address, view.camera)
    frames = deque[Frame](maxlen=FRAMES)
    async with aiohttp.ClientSession() as http, asyncio.TaskGroup() as group:
        viewing = group.create_task(
            view_frames(http, frames.append, url, view.stream_request, **how)
        )
        await until(lambda: len(frames) == FRAMES, f"{FRAMES} frames", STARTS_WITHIN_S)
        async with http.ws_connect(address("ros?", "drive"), compress=0, **how) as socket:
            driver = Driver(socket, view.camera)
            reading = group.create_task(driver.read())
            seen = await drive(driver, frames, seconds, view)
            for task in (viewing, reading):
                task.cancel()
        return seen


async def run_behind(
    link: Link, seconds: float, views: Sequence[DriverView], camera_fps: int = FPS
) -> list[list[Seen]]:
    async with linked_robot(link, camera_fps) as (site, subject):
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
    request = {"width": WIDTH, "height": HEIGHT, "fps": CAMERA_FPS}
    views = [
        DriverView({**request, "codecs": [codec]}, camera, by_newest=True)
        for camera in (CAMERA, FAST_CAMERA)
        for codec in CODECS_VIEWED
    ]
    with emulated() as link:
        loops = asyncio.run(run_behind(link, seconds, views, CAMERA_FPS))
    text = (
        "From the capture of the newest frame that a driver has to the command at the robot's guard: 38 ms, "
        f"{UP_MBIT_S} Mbit/s up, a camera of {WIDTH}x{HEIGHT} at {CAMERA_FPS} frames a second. The age is the guard's "
        "own. Drawing, encoding, the decoding of H.264 and the pause between frames are included, the screen is not. "
        f"{FAST_CAMERA} turns fast and has noise.\n\n"
        f"Aim: p50 {AIM_P50_MS} ms and p99 {AIM_P99_MS} ms by H.264."
    )
    rows = [loop_row(*pair) for pair in zip(views, loops, strict=True)]
    return Section("From a frame to the command that it leads to", text, rows)
