"""How long control takes while somebody's subscription brings a large map over a narrow uplink.

As behind_video, whose link and robot it uses: once the map comes on the connection that carries commands, as before
topics had a way of their own, and once on the media connection in the pacer's turns. Used by `bench`; needs root.
"""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass

import aiohttp
from behind_video import (
    MESSAGE_BYTES,
    RATE_HZ,
    SETTLE_S,
    UP,
    Setup,
    Site,
    measure_each,
    round_trips,
)
from link import Shape
from report import Row, Section, quantiles
from robotether_common.topics import PATH
from video_robot import MAP, MAP_BYTES

UP_MBIT_S = 1.0
NARROW = Shape(rate_bit_s=UP_MBIT_S * 1e6, delay_s=UP.delay_s, queue_bytes=UP.queue_bytes)
SECONDS = 25.0
# Time limit for the map, and for the last answer behind it.
MAP_WITHIN_S = 180.0
LATE_MS = 500.0


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
        f"A {MESSAGE_BYTES}-byte message goes to the robot and back at {RATE_HZ} Hz over an emulated link of 38 ms "
        f"and {UP_MBIT_S:g} Mbit/s up, while a subscription brings a map of {MAP_BYTES / 1e6:g} MB. Guard and relay "
        f"are not included. Late is over {LATE_MS:g} ms: the guard drops such a command, and its deadman stops the "
        "robot.\n\nAim: no late command, p99 under 250 ms, and the map within twice its share of the line."
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
        "share of the line": MAP_BYTES * 8 / setup.map_s / (UP_MBIT_S * 1e6),
    }
