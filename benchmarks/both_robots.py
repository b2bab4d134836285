"""Whether what is measured with the simulated robot holds for one with a real ROS 2 graph: both in one run.

The echo of `round_trip` straight at each rosbridge, through a guard of its own in front of it and over the whole path;
and how soon the guard stops each robot, as `stopping` has it. Used by `bench`; needs `make demo`, root and amd64.
"""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd
import ros2_robot
import stopping
from demo import Demo
from guard_process import KEY, GuardProcess
from report import Section, quantiles
from round_trip import FRAME_BYTES, RATE_HZ, measure_all

# Names of the robots, and what the page calls them.
ROBOTS = {stopping.ROBOT: "simulated", ros2_robot.NAME: "ROS 2"}
STRAIGHT, GUARDED, WHOLE = "straight to rosbridge", "through the guard", "whole path with TLS"
CAUSES = ("stop pressed", "program's connection cut", "robot's uplink cut", "guard killed")
# The message passes the guard on its way there and back.
PASSES = 2
AIM_MS = 0.2
FENCE = 1
HEADERS = {"Robotether-Key": KEY, "Robotether-Mode": "drive", "Robotether-Fence": str(FENCE)}


async def round_trips(demo: Demo, count: int) -> pd.DataFrame:
    """Each robot's times on each route, in ms."""
    async with AsyncExitStack() as stack:
        urls = {}
        for robot in ROBOTS:
            host, port = demo.address_of(robot), stopping.ROSBRIDGE_PORT
            folder = Path(stack.enter_context(TemporaryDirectory()))
            guard = await stack.enter_async_context(GuardProcess(folder, port, host))
            await guard.grant(FENCE)
            urls[f"{robot} {STRAIGHT}"] = f"ws://{host}:{port}/"
            urls[f"{robot} {GUARDED}"] = f"ws://127.0.0.1:{guard.port}/"
            urls[f"{robot} {WHOLE}"] = stopping.drive_url(demo, robot)
        routes = {route.name: route.times_ms for route in await measure_all(urls, count, HEADERS)}
    return pd.DataFrame(
        [
            {"what": route, **{robot: routes[f"{robot} {route}"] for robot in ROBOTS}}
            for route in (STRAIGHT, GUARDED, WHOLE)
        ]
    )


def stops(demo: Demo, repeat: int) -> tuple[pd.DataFrame, int]:
    """Each robot's times from the last command to zero by each cause, in ms; how often a robot continued to drive."""
    rows, continued = [], 0
    for cause in CAUSES:
        outcomes = {robot: stopping.outcome_of(demo, robot, cause, repeat) for robot in ROBOTS}
        continued += sum(outcome.drove_on for outcome in outcomes.values())
        times = {robot: outcome.last_command_to_zero for robot, outcome in outcomes.items()}
        rows.append({"what": f"{cause}, to zero", **times})
    return pd.DataFrame(rows), continued


def measure(demo: Demo, count: int, repeat: int) -> Section:
    """Measure both robots: `count` echoes on each route, and each cause `repeat` times."""
    # As the simulated robot's, its rosbridge can be reached from this machine.
    with ros2_robot.ros2_robot(demo, {"ROSBRIDGE_ADDRESS": "0.0.0.0"}):
        for robot in ROBOTS:
            stopping.wait_drivable(demo, robot)
        trips = asyncio.run(round_trips(demo, count))
        halts, continued = stops(demo, repeat)
    samples = pd.concat([trips, halts])
    table = samples[["what"]].assign(times=samples[stopping.ROBOT].map(len))
    for robot, name in ROBOTS.items():
        columns = samples[robot].map(lambda times: quantiles(times, 0.5, 0.99, unit="ms"))
        for column in columns.iloc[0]:
            table[f"{name}, {column}"] = [quantile[column] for quantile in columns]
    simulated, real = (table[f"{name}, p50, ms"] for name in ROBOTS.values())
    table["p50, times the simulated robot's"] = real / simulated
    added_ms = [p50.diff().iloc[1] / PASSES for p50 in (simulated, real)]
    return Section(
        title="The simulated robot beside one with a real ROS 2 graph",
        text=(
            f"A {FRAME_BYTES}-byte publish and its echo at {RATE_HZ} Hz, and the time from the last command to zero on "
            "`cmd_vel` when somebody presses stop or the driver is lost. The other robot has rclpy's nodes behind a "
            f"rosbridge server in Rust. The guard adds {added_ms[0]:.2f} ms to a message at p50 with the simulated "
            f"robot, and {added_ms[1]:.2f} ms with the other one. In {continued} repetitions a robot continued to "
            f"drive.\n\nAim: the guard adds at most {AIM_MS} ms, and stops both robots alike."
        ),
        rows=table,
    )
