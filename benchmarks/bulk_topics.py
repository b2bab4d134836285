"""How long control takes while somebody's subscription brings a large map over a narrow uplink.

As behind_video, whose link and robot it uses: once the map comes on the connection that carries commands, as before
topics had a way of their own, and once on the media connection in the pacer's turns. `measure_mixed` has the link of
behind_video, and video and topics on it that are together more than it takes. Used by `bench`; needs root.
"""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, field

import aiohttp
from behind_video import (
    CODECS_VIEWED,
    MESSAGE_BYTES,
    RATE_HZ,
    SETTLE_S,
    UP,
    UP_MBIT_S,
    Setup,
    Site,
    measure_each,
    round_trips,
)
from behind_video import SECONDS as MIXED_SECONDS
from behind_video import measure_setup as measure_video
from link import Shape
from report import Row, Section, quantiles
from robotether_common.topics import PATH
from video_robot import CLOUD_BYTES, CLOUD_HZ, MAP, MAP_BYTES, OFFERED_BIT_S, SCAN_HZ

NARROW_MBIT_S = 1.0
NARROW = Shape(rate_bit_s=NARROW_MBIT_S * 1e6, delay_s=UP.delay_s, queue_bytes=UP.queue_bytes)
SECONDS = 25.0
# Time limit for the map, and for the last answer behind it.
MAP_WITHIN_S = 180.0
LATE_MS = 500.0
MIXED_TOPICS = ("/scan", "/points")
AIM_P99_MS, AIM_FRAMES_PER_S = 60, 8


@dataclass
class BulkSetup(Setup):
    """One way for the map; `map_s` is how long it took."""

    on_media: bool = False
    map_s: float = 0.0


def setups() -> list[BulkSetup]:
    return [
        BulkSetup("on the connection of commands", "agent"),
        BulkSetup("beside the video, as Robotether does", "agent", on_media=True),
    ]


async def measure_setup(site: Site, setup: BulkSetup, seconds: float) -> None:
    async with aiohttp.ClientSession() as http:
        url = f"ws://127.0.0.1:{site.ros_port}/"
        async with http.ws_connect(url, compress=0, timeout=aiohttp.ClientWSTimeout()) as ros:
            taking = asyncio.create_task(take_map(http, site, setup))
            await asyncio.sleep(SETTLE_S)
            await round_trips(ros, setup, int(seconds * RATE_HZ), MAP_WITHIN_S)
            await asyncio.wait_for(taking, MAP_WITHIN_S)


async def take_map(http: aiohttp.ClientSession, site: Site, setup: BulkSetup) -> None:
    where = f"{site.video_port}{PATH}" if setup.on_media else f"{site.ros_port}/"
    started = time.perf_counter()
    async with http.ws_connect(f"ws://127.0.0.1:{where}", compress=0, max_msg_size=0) as observer:
        await observer.send_json({"op": "subscribe", "topic": "/map"})
        if await observer.receive_str() != MAP:
            raise RuntimeError("another message than the map came")
    setup.map_s = time.perf_counter() - started


def measure(seconds: float = SECONDS) -> Section:
    """Measure both ways, one after the other, and return them as a table."""
    measured = setups()
    measure_each(measured, NARROW, lambda site, setup: measure_setup(site, setup, seconds))
    text = (
        f"A {MESSAGE_BYTES}-byte message goes to the robot and back at {RATE_HZ} Hz over an emulated link of 38 "
        f"ms and {NARROW_MBIT_S:g} Mbit/s up, while a subscription brings a map of {MAP_BYTES / 1e6:g} MB. Guard and "
        f"relay are not included. Late is over {LATE_MS:g} ms: the guard drops such a command, and its deadman stops "
        "the robot.\n\nAim: no late command, p99 under 250 ms, and the map within twice its share of the line."
    )
    return Section(
        "Round trip while a map fills the uplink", text, [row(setup) for setup in measured]
    )


def row(setup: BulkSetup) -> Row:
    trips = setup.round_trips_ms
    return {
        "the map comes": setup.name,
        "round trips": len(trips),
        **quantiles(trips, 0.5, 0.99, 1, unit="ms"),
        "late": sum(trip > LATE_MS for trip in trips),
        "map in s": setup.map_s,
        "share of the line": MAP_BYTES * 8 / setup.map_s / (NARROW_MBIT_S * 1e6),
    }


@dataclass
class MixedSetup(Setup):
    """Video of one codec beside topics; `received` has the times at which their messages came, and sizes."""

    received: dict[str, list[tuple[float, int]]] = field(
        default_factory=lambda: {topic: [] for topic in MIXED_TOPICS}
    )

    ended_s: float = 0.0

    def measured(self, topic: str) -> list[int]:
        """Sizes of what came of a topic in the time that counts."""
        return [size for at_s, size in self.received[topic] if at_s >= self.ended_s - self.lasted_s]


async def measure_mixed_setup(site: Site, setup: MixedSetup, seconds: float) -> None:
    async with aiohttp.ClientSession() as http, asyncio.TaskGroup() as group:
        taking = [group.create_task(take(http, site, setup, topic)) for topic in MIXED_TOPICS]
        await measure_video(site, setup, seconds)
        setup.ended_s = time.perf_counter()
        for task in taking:
            task.cancel()


async def take(http: aiohttp.ClientSession, site: Site, setup: MixedSetup, topic: str) -> None:
    """Take a topic's messages until this is cancelled."""
    url = f"ws://127.0.0.1:{site.video_port}{PATH}"
    async with http.ws_connect(url, compress=0, max_msg_size=0) as observer:
        await observer.send_json({"op": "subscribe", "topic": topic})
        async for message in observer:
            setup.received[topic].append((time.perf_counter(), len(message.data)))
    raise ConnectionError(f"{topic} ended with {observer.close_code}")


def measure_mixed(seconds: float = MIXED_SECONDS) -> Section:
    """Measure beside video of each codec, one after the other, and return them as a table."""
    measured = [MixedSetup(codec, "agent", codec=codec) for codec in CODECS_VIEWED]
    measure_each(measured, UP, lambda site, setup: measure_mixed_setup(site, setup, seconds))
    text = (
        f"A {MESSAGE_BYTES}-byte message goes to the robot and back at {RATE_HZ} Hz over the link of behind_video: 38 "
        f"ms, {UP_MBIT_S} Mbit/s up. Beside it the camera offers {OFFERED_BIT_S / 1e6:g} Mbit/s of MJPEG, /scan comes "
        f"at {SCAN_HZ} Hz, and the robot has a PointCloud2 of {CLOUD_BYTES / 1e6:g} MB at {CLOUD_HZ} Hz. Guard and "
        "relay are not included.\n\n"
        f"Aim: p99 {AIM_P99_MS} ms and {AIM_FRAMES_PER_S} frames a second or more."
    )
    rows = [mixed_row(setup) for setup in measured]
    return Section("Round trip while video and topics fill the uplink", text, rows)


def mixed_row(setup: MixedSetup) -> Row:
    scans, clouds = (setup.measured(topic) for topic in MIXED_TOPICS)
    return {
        "video": setup.name,
        "round trips": len(setup.round_trips_ms),
        **quantiles(setup.round_trips_ms, 0.5, 0.99, 1, unit="ms"),
        "frames/s": len(setup.frame_ages_ms) / setup.lasted_s,
        **{
            f"frame age {name}": ms
            for name, ms in quantiles(setup.frame_ages_ms, 0.99, unit="ms").items()
        },
        "video Mbit/s": setup.frame_bytes * 8 / setup.lasted_s / 1e6,
        "/scan a second": len(scans) / setup.lasted_s,
        "clouds a second": len(clouds) / setup.lasted_s,
        "topics Mbit/s": sum([*scans, *clouds]) * 8 / setup.lasted_s / 1e6,
    }
