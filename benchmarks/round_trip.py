"""What a message costs on the whole path, beside what a user would have without it.

A 200-byte std_msgs/String is published at 100 Hz and comes back to the same connection, on several connections whose
messages alternate, so that what else the machine does hits all of them. The whole path is nginx, TLS, ticket, relay,
tunnel and guard; it needs `make demo` and root. Its robot is a real agent in a network of its own and not one of the
demo's containers: between those and a published port is a process of Docker's, which no other robot meets. It must
never drop a sample: a message that does not come back in 5 s ends the run.
"""

from __future__ import annotations

import asyncio
import json
import re
import time
from collections.abc import Iterator, Mapping
from contextlib import AsyncExitStack, ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import aiohttp
import pandas as pd
from bare_tunnel import bare_tunnel
from demo import Demo
from local_network import insecure_tls
from namespaces import Namespace
from paper.networks import made_in
from paper.robots import ROSBRIDGE_PORT, WholeRobot
from paper.world import World
from report import Row, Section, quantiles

FRAME_BYTES = 200
RATE_HZ = 100
COUNT, WARM_UP = 3000, 50


class Route:
    """One connection, with a topic of its own, and the round trips on it, in ms."""

    def __init__(self, name: str, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.name = name
        self.topic = "/bench_" + re.sub(r"\W+", "_", name)
        self.times_ms: list[float] = []
        self._socket = socket

    async def open(self) -> None:
        for op in ("advertise", "subscribe"):
            await self._socket.send_json({"op": op, "topic": self.topic, "type": "std_msgs/String"})
        await asyncio.sleep(0.5)

    async def measure(self, number: int) -> None:
        """Send one message of exactly FRAME_BYTES bytes and wait until it is back."""
        empty = json.dumps({"op": "publish", "topic": self.topic, "msg": {"data": ""}})
        frame = empty.replace('""', f'"{number:<{FRAME_BYTES - len(empty)}}"')
        sent = time.perf_counter()
        await self._socket.send_str(frame)
        while True:
            answer = json.loads(await self._socket.receive_str(timeout=5))
            if answer.get("op") == "publish" and int(answer["msg"]["data"]) == number:
                break
        self.times_ms.append((time.perf_counter() - sent) * 1000)

    def row(self, *parts: float) -> Row:
        trips = {"route": self.name, "round trips": len(self.times_ms)}
        return trips | quantiles(self.times_ms, *parts, unit="ms")


async def measure_all(
    urls: Mapping[str, str],
    count: int,
    headers: Mapping[str, str] | None = None,
    inside: Namespace | None = None,
) -> list[Route]:
    """Make `count` round trips each way, one after the other in every period; the first ones do not count.

    The connections are made in this network, or `inside` another.
    """
    async with AsyncExitStack() as stack:
        connector = aiohttp.TCPConnector(**made_in(inside)) if inside else None
        session = aiohttp.ClientSession(headers=headers, connector=connector)
        http = await stack.enter_async_context(session)
        routes = []
        for name, url in urls.items():
            socket = await stack.enter_async_context(
                http.ws_connect(url, ssl=insecure_tls(), compress=0, max_msg_size=0)
            )
            routes.append(Route(name, socket))
            await routes[-1].open()
        started = time.perf_counter()
        for number in range(count + WARM_UP):
            # The order turns, so that no way always comes first after the pause, which finds colder caches.
            for offset in range(len(routes)):
                await routes[(number + offset) % len(routes)].measure(number)
            pause = started + (number + 1) / RATE_HZ - time.perf_counter()
            await asyncio.sleep(max(pause, 0))
        for route in routes:
            del route.times_ms[:WARM_UP]
        return routes


@contextmanager
def whole_robot(demo: Demo) -> Iterator[WholeRobot]:
    """A robot of the demo's server, in a network of its own, which is online."""
    with TemporaryDirectory(prefix="rt-x-") as folder, ExitStack() as stack:
        world = World(demo.container, Path(folder))
        world.token = demo.token
        [uplink] = stack.enter_context(world.uplinks(1))
        [enrolled] = world.enrol(world.names("round-trip", 1))
        stack.callback(world.remove, [enrolled])
        robot = stack.enter_context(WholeRobot(world, enrolled, uplink))
        robot.wait_online()
        yield robot


def measure(demo: Demo, count: int = COUNT) -> Section:
    """The whole path, beside the robot's own rosbridge and a bare `ssh -R` as in the paper; all from its network."""
    with (
        whole_robot(demo) as robot,
        bare_tunnel(
            f"{robot.address}:{ROSBRIDGE_PORT}",
            "0.0.0.0",
            host=robot.uplink.machine,
            inside=robot.uplink.inside,
        ) as bare_port,
    ):
        ticket = robot.world.ticket(robot.name, "drive")
        urls = {
            "straight to rosbridge": robot.ros_url,
            "bare ssh -R": f"ws://{robot.uplink.machine}:{bare_port}/",
            "whole path with TLS": f"wss://{robot.world.address}/robots/{robot.name}/ros?ticket={ticket}",
        }
        routes = asyncio.run(measure_all(urls, count, inside=robot.uplink.inside))
    table = pd.DataFrame([route.row(0.5, 0.99, 1) for route in routes])
    bare = table.iloc[1]
    table["p50 above bare ssh -R, ms"] = table["p50, ms"] - bare["p50, ms"]
    table["p99, times bare ssh -R"] = table["p99, ms"] / bare["p99, ms"]
    return Section(
        f"Round trip of a {FRAME_BYTES}-byte publish and its echo at {RATE_HZ} Hz",
        "Aim: at most 0.5 ms above the bare `ssh -R` at p50, and twice its p99.",
        table,
    )
