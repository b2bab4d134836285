"""What the whole path costs, beside what a user would have without it, in one run on this machine.

A 200-byte std_msgs/String is published at 100 Hz and comes back to the same connection, on three connections whose
messages alternate: straight to the simulated robot's rosbridge, through a bare `ssh -R` as in the paper, and through
nginx, TLS, ticket, relay, tunnel and guard. Used by `bench`; needs `make demo`. It must never drop a
sample: a message that does not come back in 5 s ends the run.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Iterator
from contextlib import AsyncExitStack

import aiohttp
from bare_tunnel import BareTunnel
from demo import Demo
from local_network import insecure_tls
from sections import Section, quantile

ROBOT = "sim1"
FRAME_BYTES = 200
RATE_HZ = 100
COUNT = 3000


def targets(demo: Demo, bare_port: int) -> dict[str, str]:
    """Name and URL of each way to the same rosbridge."""
    ticket = demo.ticket(ROBOT, "drive")
    return {
        "straight to rosbridge": f"ws://{demo.address_of(ROBOT)}:9090/",
        "bare ssh -R": f"ws://127.0.0.1:{bare_port}/",
        "whole path with TLS": f"wss://{demo.address}/robots/{ROBOT}/ros?ticket={ticket}",
    }


class Route:
    """One connection and the round trips measured on it, in ms."""

    def __init__(self, name: str, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.name = name
        self.topic = "/bench_" + name.split(maxsplit=1)[0]
        self.round_trips: list[float] = []
        self._socket = socket

    async def open(self) -> None:
        """Advertise and subscribe the way's own topic."""
        for op in ("advertise", "subscribe"):
            await self._socket.send_json({"op": op, "topic": self.topic, "type": "std_msgs/String"})
        await asyncio.sleep(0.5)

    def message(self, number: int) -> str:
        """A publish of exactly FRAME_BYTES bytes that carries its number."""
        empty = json.dumps({"op": "publish", "topic": self.topic, "msg": {"data": ""}})
        return empty.replace('""', f'"{number:<{FRAME_BYTES - len(empty)}}"')

    async def measure(self, number: int) -> None:
        """One round trip."""
        sent = time.perf_counter()
        await self._socket.send_str(self.message(number))
        while True:
            answer = json.loads(await self._socket.receive_str(timeout=5))
            if answer.get("op") == "publish" and int(answer["msg"]["data"]) == number:
                break
        self.round_trips.append((time.perf_counter() - sent) * 1000)


async def _measure_all(urls: dict[str, str], count: int) -> list[Route]:
    """Measure `count` round trips each way, one after the other in every period of 10 ms."""
    async with AsyncExitStack() as stack:
        http = await stack.enter_async_context(aiohttp.ClientSession())
        routes = []
        for name, url in urls.items():
            socket = await stack.enter_async_context(
                http.ws_connect(url, ssl=insecure_tls(), compress=0)
            )
            routes.append(Route(name, socket))
            await routes[-1].open()
        started = time.perf_counter()
        for number in range(count):
            # The order turns, so that no way always comes first after the pause.
            for offset in range(len(routes)):
                await routes[(number + offset) % len(routes)].measure(number)
            pause = started + (number + 1) / RATE_HZ - time.perf_counter()
            await asyncio.sleep(max(pause, 0))
        return routes


def table(routes: list[Route]) -> Iterator[str]:
    """The result as a Markdown table, with each route beside the bare `ssh -R`."""
    bare = routes[1].round_trips
    yield "| route | round trips | p50 ms | p99 ms | max ms | p50 above bare ssh -R, ms | p99, times bare ssh -R |"
    yield "|---|---|---|---|---|---|---|"
    for route in routes:
        p50, p99 = quantile(route.round_trips, 0.5), quantile(route.round_trips, 0.99)
        yield (
            f"| {route.name} | {len(route.round_trips)} | {p50:.2f} | {p99:.2f} | {max(route.round_trips):.2f} "
            f"| {p50 - quantile(bare, 0.5):+.2f} | {p99 / quantile(bare, 0.99):.2f} |"
        )


def measure(demo: Demo, count: int = COUNT) -> Section:
    """Run it; `count` round trips each way."""
    with BareTunnel(demo.address_of(ROBOT), 9090) as bare:
        routes = asyncio.run(_measure_all(targets(demo, bare.port), count))
    return Section(
        title=f"Round trip of a {FRAME_BYTES}-byte publish and its echo at {RATE_HZ} Hz",
        text="Aim: at most 0.5 ms above the bare `ssh -R` at p50, and twice its p99.",
        table=list(table(routes)),
    )
