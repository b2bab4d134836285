"""What a message costs on the whole path, beside what a user would have without it. Used by `bench`.

It needs `make demo` and root: its robot is a real agent in a network of its own and not one of the demo's containers,
between which and a published port is a process of Docker's, which no other robot meets. Messages of several connections
alternate, so that what else the machine does hits all of them. One that does not come back in 5 s ends the run.
"""

from __future__ import annotations

import asyncio
import json
import re
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import AsyncExitStack, ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import aiohttp
import pandas as pd
from bare_tunnel import bare_tunnel
from demo import Demo
from local_network import insecure_tls
from namespaces import Namespace
from openssh_server import wait_until
from paper.programs import Program
from paper.world import World, environment
from report import Row, Section, quantiles

FRAME_BYTES = 200
RATE_HZ = 100
COUNT, WARM_UP = 3000, 50
ROSBRIDGE_PORT = 9090
ONLINE_WITHIN_S = 60.0


def made_in(namespace: Namespace) -> dict[str, Any]:
    """What has a TCPConnector make its sockets inside a namespace, where they stay; names are looked up outside."""

    def make(address: Any) -> socket.socket:
        family, kind, protocol, *_ = address
        with namespace.entered():
            return socket.socket(family, kind, protocol)

    return {"socket_factory": make}


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
        return {**trips, **quantiles(self.times_ms, *parts, unit="ms")}


async def measure_all(
    urls: Mapping[str, str],
    count: int,
    inside: Namespace,
    rate_hz: float = RATE_HZ,
) -> list[Route]:
    """Make `count` round trips each way, one after the other in every period; the first ones do not count."""
    async with AsyncExitStack() as stack:
        session = aiohttp.ClientSession(connector=aiohttp.TCPConnector(**made_in(inside)))
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
            pause = started + (number + 1) / rate_hz - time.perf_counter()
            await asyncio.sleep(max(pause, 0))
        for route in routes:
            del route.times_ms[:WARM_UP]
        return routes


@contextmanager
def whole_robot(demo: Demo, *publishes: str) -> Iterator[tuple[World, str, Namespace]]:
    """A robot of the demo's server, the ROS side and the real agent with its guard, in a network of its own; online.

    `publishes` is what the ROS side publishes by itself.
    """
    with TemporaryDirectory(prefix="rt-x-") as folder, ExitStack() as stack:
        world = World(demo.container, Path(folder))
        world.token = demo.token
        [inside] = stack.enter_context(world.uplinks(1))
        [robot] = world.enrol(world.names("round-trip", 1))
        stack.callback(world.remove, [robot])
        settings = {
            **robot.settings,
            "run_dir": f"{folder}/run",
            "rosbridge_url": f"ws://127.0.0.1:{ROSBRIDGE_PORT}",
            # A bus has no frames; so nobody looks for them every 2 s.
            "video_source": "rosbridge",
            "shell_address": "none",
        }
        programs = []
        for words in (
            ("paper.bus_robot", "127.0.0.1", str(ROSBRIDGE_PORT), *publishes),
            ("robotether_agent", "run"),
        ):
            log = robot.folder / f"{words[0]}.log"
            program = Program(inside, words, log, environment(settings))
            stack.callback(program.end)
            programs.append(program)

        def is_online() -> bool:
            for program in programs:
                program.check()
            return bool(world.ask("GET", f"/robots/{robot.name}")["online"])

        def report() -> str:
            return "\n".join([f"{robot.name} online", *(program.tail() for program in programs)])

        wait_until(is_online, report, ONLINE_WITHIN_S, every_s=0.25)
        yield world, robot.name, inside


def measure(demo: Demo, count: int = COUNT) -> Section:
    rosbridge = f"127.0.0.1:{ROSBRIDGE_PORT}"
    with (
        whole_robot(demo) as (world, name, inside),
        bare_tunnel(rosbridge, "0.0.0.0", host=world.machine, inside=inside) as bare_port,
    ):

        def measured() -> pd.DataFrame:
            ticket = world.ticket(name, "drive")
            urls = {
                "straight to rosbridge": f"ws://{rosbridge}",
                "bare ssh -R": f"ws://{world.machine}:{bare_port}/",
                "whole path with TLS": f"wss://{world.address}/robots/{name}/ros?ticket={ticket}",
            }
            return table_of(asyncio.run(measure_all(urls, count, inside)))

        alone = measured()
        world.record([name])
        recorded = measured()
    alone.insert(1, "recorded", "no")
    recorded.insert(1, "recorded", "yes")
    return Section(
        f"Round trip of a {FRAME_BYTES}-byte publish and its echo at {RATE_HZ} Hz",
        "Aim: at most 0.5 ms above the bare `ssh -R` at p50, and 1.3 times its p99, both of the same run. The robot is "
        "driven; the second run is while a recording of it lasts.",
        pd.concat([alone, recorded], ignore_index=True),
    )


def table_of(routes: list[Route]) -> pd.DataFrame:
    """The rows of one run, beside its bare tunnel's."""
    table = pd.DataFrame([route.row(0.5, 0.99, 1) for route in routes])
    bare = table.iloc[1]
    table["p50 above bare ssh -R, ms"] = table["p50, ms"] - bare["p50, ms"]
    table["p99, times bare ssh -R"] = table["p99, ms"] / bare["p99, ms"]
    return table
