"""What observers of the same topics cost the robot's uplink and the relay. Used by `bench`.

`fan_out` has observers straight at the relay, as viewers are (video.py). `beside_clouds` has the round trips of
round_trip.py beside observers of a lidar's clouds, a process of their own: `python -m fan_out`. Both need `make demo`,
the second also root.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import aiohttp
import pandas as pd
from demo import Demo
from local_network import insecure_tls
from paper.bus_robot import CLOUD, CLOUD_HZ
from paper.programs import LineProgram, write_line
from report import Row, Section
from round_trip import FRAME_BYTES, ROSBRIDGE_PORT, Route, measure_all, whole_robot
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
# Observers of clouds beside a driver.
CLOUD_OBSERVERS, DRIVER_HZ = 5, 20
DRIVEN_S = 60.0
CLOUDS_WITHIN_S = 30.0
AIM_ALONE_MS, AIM_BESIDE_MS = 13, 30


class Observer:
    """Counts what comes, by topic; it parses only until each topic has come once."""

    def __init__(self, topics: Sequence[str]) -> None:
        self.messages = 0
        self.bytes = 0
        self.missing = set(topics)

    async def observe(self, http: aiohttp.ClientSession, url: str, topics: Sequence[str]) -> None:
        async with http.ws_connect(
            url, ssl=insecure_tls(), compress=0, max_msg_size=0, decode_text=False
        ) as socket:
            for topic in topics:
                kind = {"type": FAST_TYPE} if topic == FAST else {}
                await socket.send_json({"op": "subscribe", "topic": topic, **kind})
            async for message in socket:
                self.messages += 1
                self.bytes += len(message.data)
                if self.missing:
                    self.missing.discard(json.loads(message.data).get("topic"))
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
    address = f"http://{demo.address_of('relay')}:{RELAY_PORT}/robots/{ROBOT}/ros"
    return [f"{address}?ticket={demo.ticket(ROBOT, 'observe')}" for _ in range(count)]


async def run_observers(demo: Demo, topics: Sequence[str], count: int, seconds: float) -> Row:
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
        lasted_s = time.monotonic() - started
        messages = sum(observer.messages for observer in observers) - before
        return {
            "topics": ", ".join(topics),
            "observers": count,
            "messages/s each": messages / lasted_s / count,
            "robot's uplink KB": (usage.uplink_bytes() - uplink) / 1000,
            "relay, % of a core": (usage.relay_cpu_s() - cpu_s) / lasted_s * 100,
        }


async def measure_runs(demo: Demo, seconds: float) -> list[Row]:
    """Measure all, with the media connection open, as it stays for a while."""
    async with observing(urls_of(demo, 1), SENSORS):
        pass
    runs = [await run_observers(demo, SENSORS, count, seconds) for count in SENSOR_COUNTS]
    rosbridge = f"ws://{demo.address_of(ROBOT)}:{ROSBRIDGE_PORT}/"
    async with going_on([publish_fast(rosbridge)], lambda: True, "fast messages"):
        return runs + [await run_observers(demo, (FAST,), count, seconds) for count in FAST_COUNTS]


def compared(runs: Sequence[Row]) -> pd.DataFrame:
    table = pd.DataFrame(runs)
    first = table.groupby("topics").transform("first")
    uplink, cpu = "robot's uplink KB", "relay, % of a core"
    table["uplink, times one"] = table[uplink] / first[uplink]
    more = (table.observers * table["messages/s each"]) - first["messages/s each"]
    table[f"{cpu} for each further 1000 messages/s"] = (table[cpu] - first[cpu]) / more * 1000
    return table


def measure(demo: Demo, seconds: float = SECONDS) -> Section:
    text = (
        f"Each row took {seconds:g} s from before the first observer subscribed. All that leaves the robot in it "
        f"counts, the map of a latched topic too, and all of the relay's processor time. {FAST} has {FAST_HZ} messages "
        f"a second of {FAST_BYTES} characters. Observers connect to the relay itself, without nginx and TLS.\n\n"
        f"Aim: {SENSOR_COUNTS[-1]} observers within {AIM_TIMES} times the uplink of one, and {AIM_PERCENT} % of a core "
        f"for each further observer of {FAST_HZ} messages a second."
    )
    table = compared(asyncio.run(measure_runs(demo, seconds)))
    return Section("What observers of topics cost the robot's uplink and the relay", text, table)


async def take_clouds(urls: Sequence[str]) -> None:
    """Observe clouds until the input ends; write when all have one, and at the end how much they got in a second."""
    async with observing(urls, (CLOUD,)) as observers:
        before = sum(each.messages for each in observers), sum(each.bytes for each in observers)
        started = time.monotonic()
        write_line({"ready": True})
        await asyncio.to_thread(sys.stdin.read)
        lasted_s = time.monotonic() - started
        messages = sum(each.messages for each in observers) - before[0]
        size = sum(each.bytes for each in observers) - before[1]
    write_line({"messages_per_s": messages / lasted_s, "bytes_per_s": size / lasted_s})


def measure_beside(demo: Demo, seconds: float = DRIVEN_S) -> Section:
    count = int(seconds * DRIVER_HZ)
    with whole_robot(demo, "CLOUD") as (world, name, inside), TemporaryDirectory() as folder:

        def routes() -> list[Route]:
            urls = {
                "straight to rosbridge": f"ws://127.0.0.1:{ROSBRIDGE_PORT}",
                "whole path with TLS": f"wss://{world.address}/robots/{name}/ros?ticket={world.ticket(name, 'drive')}",
            }
            return asyncio.run(measure_all(urls, count, inside, DRIVER_HZ))

        measured = [cloud_row(route, 0, {}) for route in routes()]
        address = f"wss://{world.address}/robots/{name}/ros?ticket="
        with LineProgram("fan_out", Path(folder) / "log") as observers:
            observers.send(
                [address + world.ticket(name, "observe") for _ in range(CLOUD_OBSERVERS)]
            )
            observers.receive("that all have a cloud", CLOUDS_WITHIN_S)
            beside = routes()
            observers.end_input()
            got = observers.receive("what observers got", CLOUDS_WITHIN_S)
        measured += [cloud_row(route, CLOUD_OBSERVERS, got) for route in beside]
    text = (
        f"A {FRAME_BYTES}-byte message goes to the robot and back at {DRIVER_HZ} Hz, alone and beside "
        f"{CLOUD_OBSERVERS} observers of a PointCloud2 of 7.3 MB that the robot sends at {CLOUD_HZ} Hz. All "
        "connections but the straight one go through nginx, TLS, relay, tunnel and agent, on one machine, without a "
        "limit on the line. Beside the clouds the robot's rosbridge, which is one process, is late by itself: the "
        f"straight row has it.\n\nAim: p99 {AIM_ALONE_MS} ms alone and {AIM_BESIDE_MS} ms beside the observers, on the "
        "whole path."
    )
    return Section("A driver beside observers of point clouds", text, measured)


def cloud_row(route: Route, observers: int, got: Row) -> Row:
    each, size = got.get("messages_per_s"), got.get("bytes_per_s")
    return {
        "observers": observers,
        **route.row(0.5, 0.99, 1),
        "clouds/s each": each / observers if isinstance(each, float) else None,
        "MB/s to observers": size / 1e6 if isinstance(size, float) else None,
    }


if __name__ == "__main__":
    asyncio.run(take_clouds(json.loads(sys.stdin.readline())))
