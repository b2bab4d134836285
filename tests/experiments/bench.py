"""`make bench`: what the whole path costs, beside what a user would have without it, in one run on this machine.

A 200-byte std_msgs/String is published at 100 Hz and comes back to the same connection, on three connections whose
messages alternate: straight to the simulated robot's rosbridge, through its bare `ssh -R` (the forwarded port of sshd,
as in the paper), and through browser's door, nginx, TLS, ticket and relay. Needs `make demo`. It prints a table and
writes it to docs/measurements.md. It must never drop a sample: a message that does not come back in 5 s ends the run.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import platform
import statistics
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import AsyncExitStack
from datetime import UTC, datetime
from pathlib import Path

import aiohttp
import docker
from local_network import insecure_tls

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "measurements.md"
ROBOT = "sim1"
FRAME_BYTES = 200
RATE_HZ = 100
TOKEN_NAME = "bench"


def compose(*arguments: str) -> str:
    """Run tools/compose and return what it printed."""
    done = subprocess.run(
        [str(ROOT / "tools" / "compose"), "--demo", *arguments],
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout


def address_of(service: str, network: str) -> str:
    """The address of a demo container, which this machine reaches and nobody else does."""
    project = json.loads(compose("config", "--format", "json"))["name"]
    labels = [f"com.docker.compose.project={project}", f"com.docker.compose.service={service}"]
    [container] = docker.from_env().containers.list(filters={"label": labels})
    return str(container.attrs["NetworkSettings"]["Networks"][f"{project}_{network}"]["IPAddress"])


def outside_address() -> str:
    """An address of this machine at which the published ports answer as they do to the network."""
    bridge = docker.from_env().networks.get("bridge")
    return str(bridge.attrs["IPAM"]["Config"][0]["Gateway"])


def new_token() -> str:
    """An API token for this run."""
    name = f"{TOKEN_NAME}-{int(time.time())}"
    return compose(
        "exec", "-T", "web", "robotether", "token", "create", "--user", "admin", "--name", name, "--days", "1"
    ).split()[-1]  # fmt: skip


def get_json(url: str, token: str, body: dict[str, str] | None = None) -> dict[str, object]:
    """One request to the server's API."""
    request = urllib.request.Request(
        url,
        data=None if body is None else json.dumps(body).encode(),
        headers={"Content-Type": "application/json", "Authorization": f"Bearer {token}"},
    )
    with urllib.request.urlopen(request, context=insecure_tls(), timeout=10) as answer:
        parsed: dict[str, object] = json.load(answer)
        return parsed


def targets() -> dict[str, str]:
    """Name and URL of each way to the same rosbridge."""
    published = compose("port", "nginx", "8443").strip().rsplit(":", 1)[1]
    # Not localhost, which Docker serves by a proxy process of its own: from outside no such process is in the way.
    door = f"{outside_address()}:{published}"
    server = f"https://{door}"
    token = new_token()
    robots = get_json(f"{server}/api/v1/robots", token)["robots"]
    assert isinstance(robots, list)
    port = next(robot["ros_port"] for robot in robots if robot["name"] == ROBOT)
    ticket = get_json(f"{server}/api/v1/tickets", token, {"robot": ROBOT, "mode": "drive"})[
        "ticket"
    ]
    return {
        "straight to rosbridge": f"ws://{address_of(ROBOT, ROBOT)}:9090/",
        "bare ssh -R": f"ws://{address_of('sshd', 'tunnel')}:{port}/",
        "whole path with TLS": f"wss://{door}/robots/{ROBOT}/ros?ticket={ticket}",
    }


class Way:
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


async def run(count: int) -> list[Way]:
    """Measure `count` round trips each way, one after the other in every period of 10 ms."""
    async with AsyncExitStack() as stack:
        http = await stack.enter_async_context(aiohttp.ClientSession())
        ways = []
        for name, url in (await asyncio.to_thread(targets)).items():
            socket = await stack.enter_async_context(
                http.ws_connect(url, ssl=insecure_tls(), compress=0)
            )
            ways.append(Way(name, socket))
            await ways[-1].open()
        started = time.perf_counter()
        for number in range(count):
            # The order turns, so that no way always comes first after the pause.
            for offset in range(len(ways)):
                await ways[(number + offset) % len(ways)].measure(number)
            pause = started + (number + 1) / RATE_HZ - time.perf_counter()
            await asyncio.sleep(max(pause, 0))
        return ways


def percentile(values: list[float], percent: int) -> float:
    """The value that `percent` of 100 stay below, as statistics.quantiles has it."""
    return statistics.quantiles(values, n=100, method="inclusive")[percent - 1]


def table(ways: list[Way]) -> Iterator[str]:
    """The result as a Markdown table, with each way beside the bare `ssh -R`."""
    bare = ways[1].round_trips
    yield "| way | round trips | p50 ms | p99 ms | max ms | p50 more than bare ssh -R, ms | p99, times bare ssh -R |"
    yield "|---|---|---|---|---|---|---|"
    for way in ways:
        p50, p99 = percentile(way.round_trips, 50), percentile(way.round_trips, 99)
        yield (
            f"| {way.name} | {len(way.round_trips)} | {p50:.2f} | {p99:.2f} | {max(way.round_trips):.2f} "
            f"| {p50 - percentile(bare, 50):+.2f} | {p99 / percentile(bare, 99):.2f} |"
        )


def page(lines: list[str]) -> str:
    """docs/measurements.md, with what it was measured on."""
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()
    cpu = next(
        (line.split(":", 1)[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines()
         if line.startswith("model name")), platform.machine(),
    )  # fmt: skip
    head = f"""# Measurements

Written by `make bench` on {datetime.now(UTC):%Y-%m-%d} at commit {commit}; {cpu}, {os.cpu_count()} cores,
everything on this one machine, Linux {platform.release().split("-")[0]}, Python {platform.python_version()}.
Compare within a table, not between runs.

## Round trip of a {FRAME_BYTES}-byte publish and its echo at {RATE_HZ} Hz

Aim: at most 0.5 ms more than the bare `ssh -R` at p50, twice at p99.

"""
    return head + "\n".join(lines) + "\n"


def main() -> None:
    """Measure, print, write."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument(
        "--count", type=int, default=3000, help="round trips each way (default 3000, 30 s)"
    )
    chosen = arguments.parse_args()
    lines = list(table(asyncio.run(run(chosen.count))))
    PAGE.write_text(page(lines))
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
