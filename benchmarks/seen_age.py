"""How right the age of what a driver sees is, against the clock that the simulated camera has drawn into the frame.

A program views the demo's robot as a page does, and names one of the last frames in each command. The guard's age comes
back on its connection. It is compared with the frame's age by the drawn clock when the command was sent, on the same
machine's clock; on loopback the command's way on to the guard is all that may be between them. Used by `bench`; needs
`make demo`. The robot moves some millimetres.
"""

from __future__ import annotations

import asyncio
import random
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

import aiohttp
from demo import Demo
from frame_stamp import read_stamp
from local_network import insecure_tls
from report import Row, Section, quantiles
from robotether_common.frames import HEADER, MAX_CREDITS
from video import CAMERA, ROBOT, STARTS_WITHIN_S

SECONDS = 60.0
# Interval between commands: the guard reports twice a second, so that each report is of one command.
COMMAND_EVERY_S = 0.7
REPORTED_WITHIN_S = 3.0
SPEED_M_S = 0.01
# Number of the last frames of which each command names one.
FRAMES = 10
# The drawn clock has tenths of a ms, and so has the reported age.
ROUNDED_MS = 0.2
AIM_MS = 10.0


@dataclass(frozen=True)
class Seen:
    """The age of a frame in ms when a command that names it was sent, and as the guard measured it."""

    sent_ms: float
    guards_ms: float

    @property
    def error_ms(self) -> float:
        """How much more the guard measured."""
        return self.guards_ms - self.sent_ms


class Camera:
    """The last frames that came, by their sequence number."""

    def __init__(self) -> None:
        self.frames: deque[tuple[int, bytes]] = deque(maxlen=FRAMES)
        self.is_full = asyncio.Event()

    async def view(self, http: aiohttp.ClientSession, url: str) -> None:
        """Take frames by credit until this is cancelled."""
        async with http.ws_connect(url, ssl=insecure_tls(), compress=0, max_msg_size=0) as socket:
            await socket.send_json({"op": "stream_request"})
            await socket.send_json({"op": "credit", "frames": MAX_CREDITS})
            async for message in socket:
                if message.type is aiohttp.WSMsgType.BINARY:
                    sequence = HEADER.unpack_from(message.data)[3]
                    await socket.send_json({"op": "credit", "frames": 1, "taken": sequence})
                    self.frames.append((sequence, message.data[HEADER.size :]))
                    if len(self.frames) == FRAMES:
                        self.is_full.set()
            raise ConnectionError(f"the frames ended with {socket.close_code}")


class Driver:
    """A connection that drives; it reads all the time, as the age of a command counts from an answered ping."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket = socket
        self._answers: asyncio.Queue[dict[str, Any]] = asyncio.Queue()

    async def read(self) -> None:
        """Keep what the relay says of commands, until the connection ends or this is cancelled."""
        # Who sends one gets what the relay says itself.
        await self._socket.send_json({"op": "robotether.clock_sync", "t_ms": 0})
        async for message in self._socket:
            answer = message.json()
            if answer.get("op") in {"robotether.seen", "status"}:
                self._answers.put_nowait(answer)
        raise ConnectionError(f"the drive ended with {self._socket.close_code}")

    async def command(self, sequence: int, jpeg: bytes, speed: float) -> Seen:
        """Send one command that names this frame, and wait for the guard's age."""
        drawn_at = read_stamp(jpeg)
        stamp = {"seen": [{"camera": CAMERA, "frame": sequence}]}
        message = {"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": speed}}}
        sent_at = time.time()
        await self._socket.send_json({**message, "robotether": stamp})
        answer = await asyncio.wait_for(self._answers.get(), REPORTED_WITHIN_S)
        if answer["op"] == "status":
            raise RuntimeError(f"cannot measure: {answer.get('msg')}")
        if answer["age_ms"] is None:
            raise RuntimeError("cannot measure: the guard does not know the frame")
        return Seen((sent_at - drawn_at) * 1000, answer["age_ms"])


async def drive(driver: Driver, camera: Camera, seconds: float) -> list[Seen]:
    """Drive for so long, to and fro, with any of the last frames at each command."""
    chance, seen = random.Random(1), list[Seen]()
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        speed = SPEED_M_S * (-1) ** len(seen)
        seen.append(await driver.command(*chance.choice(camera.frames), speed))
        await asyncio.sleep(COMMAND_EVERY_S)
    return seen


async def run(demo: Demo, seconds: float) -> list[Seen]:
    """Have somebody drive who views the robot's camera."""
    robot = f"{demo.url}/robots/{ROBOT}"
    frames = f"{robot}/video/frames?topic={CAMERA}&ticket={demo.ticket(ROBOT, 'observe')}"
    ros = f"{robot}/ros?ticket={demo.ticket(ROBOT, 'drive')}"
    camera = Camera()
    async with aiohttp.ClientSession() as http:
        tasks = [asyncio.ensure_future(camera.view(http, frames))]
        try:
            await asyncio.wait_for(camera.is_full.wait(), STARTS_WITHIN_S)
            async with http.ws_connect(ros, ssl=insecure_tls(), compress=0) as socket:
                driver = Driver(socket)
                tasks += [
                    asyncio.ensure_future(driver.read()),
                    asyncio.ensure_future(drive(driver, camera, seconds)),
                ]
                done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                # Only the drive ends by itself; another one has failed.
                for task in done - {tasks[-1]}:
                    task.result()
                return tasks[-1].result()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


def row(seen: list[Seen]) -> Row:
    """What was measured: how old the frames were, and how much more the guard measured."""
    errors = [item.error_ms for item in seen]
    return {
        "commands": len(seen),
        "age when sent, p50, ms": quantiles([item.sent_ms for item in seen], 0.5, unit="ms")[
            "p50, ms"
        ],
        "error, least, ms": min(errors),
        **{
            f"error, {name}": value
            for name, value in quantiles(errors, 0.5, 0.99, 1, unit="ms").items()
        },
        "too young": sum(error < -ROUNDED_MS for error in errors),
        "over the aim": sum(error > AIM_MS for error in errors),
    }


def measure(demo: Demo, seconds: float = SECONDS) -> Section:
    """Measure on loopback over the whole demo."""
    text = (
        f"A program on loopback names one of the last {FRAMES} frames in each command. The error is the age that the "
        "robot's guard reports, less the frame's age by the clock drawn into it when the command was sent. The "
        "command's way to the guard is part of the error.\n\n"
        f"Aim: never too young, and at most {AIM_MS:g} ms too old."
    )
    return Section(
        "Error of the age of what a driver sees", text, [row(asyncio.run(run(demo, seconds)))]
    )
