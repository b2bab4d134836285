"""What observers of the same topics cost the robot's uplink and the relay.

The uplink is that of a simulated robot's laser, odometry and map: what leaves the robot from before the first observer
subscribes until all have had the topics for a while, so that the map's copy counts, too. The relay's processor is that
of a topic at 1000 messages a second, which this process publishes at the robot's own rosbridge. Observers connect to
the relay itself, as viewers do (video.py). Used by `bench`; needs `make demo`.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass

import aiohttp
from demo import Demo
from report import Row, Section
from round_trip import ROSBRIDGE_PORT
from video import RELAY_PORT, ROBOT, Usage, going_on

SENSORS = ("/scan", "/odom", "/map")
SENSOR_COUNTS = (1, 20)
FAST, FAST_TYPE, FAST_HZ = "/fan_out", "std_msgs/String", 1000
FAST_COUNTS = (1, 5, 9)
FAST_BYTES = 100
SECONDS = 20.0
# Time after which no subscription of the run before is left: the robot keeps the last one's for 0.5 s.
SETTLE_S = 2.0
AIM_TIMES, AIM_PERCENT = 1.05, 15


@dataclass(frozen=True)
class Run:
    """What so many observers of the same topics have cost."""

    topics: str
    observers: int
    lasted_s: float
    messages: int
    uplink_bytes: int
    relay_cpu_s: float


class Observer:
    """Counts what comes, by topic; it parses only until each topic has come once."""

    def __init__(self, topics: Sequence[str]) -> None:
        self.messages = 0
        self.missing = set(topics)

    async def observe(self, http: aiohttp.ClientSession, url: str, topics: Sequence[str]) -> None:
        """Count until this is cancelled."""
        async with http.ws_connect(url, compress=0, max_msg_size=0) as socket:
            for topic in topics:
                kind = {"type": FAST_TYPE} if topic == FAST else {}
                await socket.send_json({"op": "subscribe", "topic": topic, **kind})
            async for message in socket:
                self.messages += 1
                if self.missing:
                    self.missing.discard(message.json().get("topic"))
        raise ConnectionError(f"the topics ended with {socket.close_code}")


@asynccontextmanager
async def observing(
    urls: Sequence[str], topics: Sequence[str]
) -> AsyncIterator[Sequence[Observer]]:
    """Observers, one a URL; each has had all topics when this begins."""
    observers = [Observer(topics) for _ in urls]
    what = f"each of {len(urls)} observers has {', '.join(topics)}"
    async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as http:
        works = [
            observer.observe(http, url, topics)
            for observer, url in zip(observers, urls, strict=True)
        ]
        async with going_on(works, lambda: not any(item.missing for item in observers), what):
            yield observers


async def publish_fast(url: str) -> None:
    """Publish at FAST_HZ until this is cancelled; what a late turn of this process missed comes at once."""
    async with (
        aiohttp.ClientSession() as http,
        http.ws_connect(url, compress=0) as socket,
    ):
        await socket.send_json({"op": "advertise", "topic": FAST, "type": FAST_TYPE})
        message = {"op": "publish", "topic": FAST, "msg": {"data": "x" * FAST_BYTES}}
        started, sent = time.monotonic(), 0
        while True:
            while sent < (time.monotonic() - started) * FAST_HZ:
                await socket.send_json(message)
                sent += 1
            await asyncio.sleep(1 / FAST_HZ)


def urls_of(demo: Demo, count: int) -> list[str]:
    """Addresses of so many observers' connections, straight at the relay."""
    address = f"http://{demo.address_of('relay')}:{RELAY_PORT}/robots/{ROBOT}/ros"
    return [f"{address}?ticket={demo.ticket(ROBOT, 'observe')}" for _ in range(count)]


async def run_observers(demo: Demo, topics: Sequence[str], count: int, seconds: float) -> Run:
    """Have so many observe; the uplink counts from before they subscribe, the rest once all have all topics."""
    urls = urls_of(demo, count)
    await asyncio.sleep(SETTLE_S)
    usage = Usage(demo)
    uplink, begun = usage.uplink_bytes(), time.monotonic()
    async with observing(urls, topics) as observers:
        cpu_s, started = usage.relay_cpu_s(), time.monotonic()
        if started - begun > seconds / 2:
            raise RuntimeError(
                f"cannot measure: {count} observers took {started - begun:.1f} s to come"
            )
        before = sum(observer.messages for observer in observers)
        # All runs take the same time, however long their observers needed to come.
        await asyncio.sleep(begun + seconds - started)
        return Run(
            ", ".join(topics),
            count,
            time.monotonic() - started,
            sum(observer.messages for observer in observers) - before,
            usage.uplink_bytes() - uplink,
            usage.relay_cpu_s() - cpu_s,
        )


async def measure_runs(demo: Demo, seconds: float) -> list[Run]:
    """Measure all, with the media connection open, as it stays for a while."""
    async with observing(urls_of(demo, 1), SENSORS):
        pass
    runs = [await run_observers(demo, SENSORS, count, seconds) for count in SENSOR_COUNTS]
    rosbridge = f"ws://{demo.address_of(ROBOT)}:{ROSBRIDGE_PORT}/"
    publishing = asyncio.create_task(publish_fast(rosbridge))
    try:
        for count in FAST_COUNTS:
            runs.append(await run_observers(demo, (FAST,), count, seconds))
            if publishing.done():
                publishing.result()
    finally:
        publishing.cancel()
        await asyncio.gather(publishing, return_exceptions=True)
    return runs


def rows(runs: Sequence[Run]) -> list[Row]:
    """Compare each run with the first of the same topics."""
    firsts = {run.topics: run for run in reversed(runs)}
    return [row(run, firsts[run.topics]) for run in runs]


def row(measured: Run, first: Run) -> Row:
    """A run's row; the processor of further observers is that of the messages that they got more than the first."""
    per_s, first_per_s = measured.messages / measured.lasted_s, first.messages / first.lasted_s
    cpu, first_cpu = measured.relay_cpu_s / measured.lasted_s, first.relay_cpu_s / first.lasted_s
    further = None if measured is first else (cpu - first_cpu) / (per_s - first_per_s) * 1000 * 100
    return {
        "topics": measured.topics,
        "observers": measured.observers,
        "messages/s each": per_s / measured.observers,
        "robot's uplink KB": measured.uplink_bytes / 1000,
        "uplink, times one": measured.uplink_bytes / first.uplink_bytes,
        "relay, % of a core": cpu * 100,
        "relay, % of a core for each further 1000 messages/s": further,
    }


def measure(demo: Demo, seconds: float = SECONDS) -> Section:
    """Measure all, one after the other, and return them as a table."""
    text = (
        f"Each row took {seconds:g} s from before the first observer subscribed. All that leaves the robot in it "
        f"counts, the map of a latched topic too, and all of the relay's processor time. {FAST} has {FAST_HZ} messages "
        f"a second of {FAST_BYTES} characters. Observers connect to the relay itself, without nginx and TLS.\n\n"
        f"Aim: {SENSOR_COUNTS[-1]} observers within {AIM_TIMES} times the uplink of one, and {AIM_PERCENT} % of a core "
        f"for each further observer of {FAST_HZ} messages a second."
    )
    runs = asyncio.run(measure_runs(demo, seconds))
    return Section(
        "What observers of topics cost the robot's uplink and the relay", text, rows(runs)
    )
