"""How old what a driver sees is when the robot obeys the command that it leads to: from capture to guard.

A program drives a robot behind an emulated link like the worst of the paper's by the newest frame that it
has, and the guard says how old that frame was when the command reached it. A screen, an eye and a hand are missing.
Used by `bench`; needs root. The robot moves some millimetres.
"""

from __future__ import annotations

import asyncio

from linked_robot import UP_MBIT_S, emulated
from report import Row, Section, quantiles
from seen_age import DriverView, Seen, run_behind
from video import CAMERA, CODECS_VIEWED, FAST_CAMERA

SECONDS = 60.0
WIDTH, HEIGHT, CAMERA_FPS = 1280, 720, 25
AIM_P50_MS, AIM_P99_MS = 90, 150


def views() -> list[DriverView]:
    request = {"width": WIDTH, "height": HEIGHT, "fps": CAMERA_FPS}
    return [
        DriverView({**request, "codecs": [codec]}, camera, by_newest=True)
        for camera in (CAMERA, FAST_CAMERA)
        for codec in CODECS_VIEWED
    ]


def row(view: DriverView, seen: list[Seen]) -> Row:
    return {
        "camera": view.camera,
        # Of the frames that came, whatever was requested.
        "codec": ", ".join(sorted({command.codec for command in seen})),
        "commands": len(seen),
        **quantiles([command.guards_ms for command in seen], 0.5, 0.95, 0.99, unit="ms"),
    }


def measure(seconds: float = SECONDS) -> Section:
    """Measure each camera by each codec, one after the other."""
    with emulated() as link:
        loops = asyncio.run(run_behind(link, seconds, views(), CAMERA_FPS))
    text = (
        "From the capture of the newest frame that a driver has to the command at the robot's guard: 38 ms, "
        f"{UP_MBIT_S} Mbit/s up, a camera of {WIDTH}x{HEIGHT} at {CAMERA_FPS} frames a second. The age is the guard's "
        "own. Drawing, encoding, the decoding of H.264 and the pause between frames are included, the screen is not. "
        f"{FAST_CAMERA} turns fast and has noise.\n\n"
        f"Aim: p50 {AIM_P50_MS} ms and p99 {AIM_P99_MS} ms by H.264."
    )
    rows = [row(*pair) for pair in zip(views(), loops, strict=True)]
    return Section("From a frame to the command that it leads to", text, rows)
