"""What viewers cost: the robot's uplink and the relay's processor time with 1, 5 and 20 of them on one camera.

The demo's robot, each viewer a WebSocket of its own by the frames protocol, straight at the relay: nginx and TLS are
not in the relay's time. Used by `bench`; needs `make demo`.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import aiohttp
from demo import Demo
from relay_server import until
from sections import Section
from video_viewers import Frame, view_frames

ROBOT, CAMERA = "sim1", "/camera/image_raw"
COUNTS = (1, 5, 20)
SECONDS = 10.0
SETTLE_S = 3.0
STARTS_WITHIN_S = 20.0
RELAY_PORT = 8080
FPS = 15
# One quality, so that no run has smaller pictures than another; it makes pictures of some 30 KB.
STREAM_REQUEST = {"quality_min": 75, "quality_max": 75, "fps": FPS, "latency_ms": 5000}
AIM_PERCENT = 5


@dataclass(frozen=True)
class Run:
    """What so many viewers cost."""

    viewers: int
    frames: int
    frame_bytes: int
    uplink_bytes: int
    relay_cpu_s: float
    lasted_s: float

    @property
    def uplink_kb_s(self) -> float:
        """What left the robot."""
        return self.uplink_bytes / self.lasted_s / 1000

    @property
    def cpu_per_100(self) -> float:
        """The relay's share of a core, in percent, for each 100 pictures that it delivers in a second."""
        return self.relay_cpu_s / self.frames * 100 * 100


class Usage:
    """What the kernel has counted for two containers."""

    def __init__(self, demo: Demo) -> None:
        processes = demo.container("relay").top()["Processes"]
        self._relay_pids = [int(process[1]) for process in processes]
        self._robot_pid = demo.container(ROBOT).attrs["State"]["Pid"]

    def relay_cpu_s(self) -> float:
        """Processor time of the relay's processes since their start."""
        tasks = [task for pid in self._relay_pids for task in Path(f"/proc/{pid}/task").iterdir()]
        return sum(int((task / "schedstat").read_text().split()[0]) for task in tasks) / 1e9

    def uplink_bytes(self) -> int:
        """What has left the robot by its network."""
        lines = Path(f"/proc/{self._robot_pid}/net/dev").read_text().splitlines()
        [counts] = [
            line.split(":")[1].split() for line in lines if line.strip().startswith("eth0:")
        ]
        return int(counts[8])


@asynccontextmanager
async def watched(demo: Demo, viewers: int) -> AsyncIterator[list[list[Frame]]]:
    """So many viewers, each with its own pictures; all have one when this begins."""
    address = f"http://{demo.address_of('relay')}:{RELAY_PORT}/robots/{ROBOT}/video/frames"
    seen: list[list[Frame]] = [[] for _ in range(viewers)]
    async with AsyncExitStack() as stack:
        http = await stack.enter_async_context(aiohttp.ClientSession())
        tasks = []
        for own in seen:
            ticket = await asyncio.to_thread(demo.ticket, ROBOT, "observe")
            url = f"{address}?topic={CAMERA}&ticket={ticket}"
            tasks.append(asyncio.ensure_future(view_frames(http, url, own.append, STREAM_REQUEST)))
        try:
            await until(
                lambda: all(seen) or any(task.done() for task in tasks),
                f"a frame for each of {viewers}",
                STARTS_WITHIN_S,
            )
            yield seen
            for task in tasks:
                if task.done():
                    task.result()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


async def run(demo: Demo, viewers: int, seconds: float) -> Run:
    """Measure with so many viewers."""
    usage = Usage(demo)
    async with watched(demo, viewers) as seen:
        await asyncio.sleep(SETTLE_S)
        for own in seen:
            own.clear()
        cpu_s, uplink = usage.relay_cpu_s(), usage.uplink_bytes()
        started = time.monotonic()
        await asyncio.sleep(seconds)
        frames = [frame for own in seen for frame in own]
        lasted_s, uplink = time.monotonic() - started, usage.uplink_bytes() - uplink
        cpu_s = usage.relay_cpu_s() - cpu_s
    size = sum(len(frame.jpeg) for frame in frames)
    return Run(viewers, len(frames), size, uplink, cpu_s, lasted_s)


def table(runs: list[Run]) -> Iterator[str]:
    """The result, each beside one viewer."""
    yield (
        "| viewers | frames/s each | KB a frame | robot's uplink KB/s | change from one viewer | relay, % of a core "
        "| relay, % of a core for 100 frames/s | viewers a core at 15 fps |"
    )
    yield "|---|---|---|---|---|---|---|---|"
    for one in runs:
        beside = (one.uplink_kb_s / runs[0].uplink_kb_s - 1) * 100
        yield (
            f"| {one.viewers} | {one.frames / one.viewers / one.lasted_s:.1f} "
            f"| {one.frame_bytes / one.frames / 1000:.1f} | {one.uplink_kb_s:.0f} | {beside:+.1f} % "
            f"| {one.relay_cpu_s / one.lasted_s * 100:.1f} | {one.cpu_per_100:.1f} "
            f"| {100 * 100 / one.cpu_per_100 / FPS:.0f} |"
        )


def measure(demo: Demo, seconds: float = SECONDS) -> Section:
    """Measure with each number of viewers."""
    runs = [asyncio.run(run(demo, viewers, seconds)) for viewers in COUNTS]
    return Section(
        title="What viewers cost the robot's uplink and the relay",
        text=(
            f"One camera of 640x480 at {FPS} frames a second and quality 75, {seconds:g} s a row. All that leaves the "
            "robot counts, and all of the relay's processor time, when idle too. Viewers connect to the relay itself, "
            "without nginx and TLS.\n\n"
            f"Aim: the uplink stays the same within {AIM_PERCENT} %."
        ),
        table=list(table(runs)),
    )
