"""What the guard adds to a message: round trips of 200 bytes straight to rosbridge and through the guard, in turn.

Used by `bench`. rosbridge is the simulated robot's, in a process of its own as on a robot; the guard is the real
process. Both ways alternate in one run, so that what else the machine does hits both. The message goes to a topic that
does not drive and comes back by a subscription: it passes the guard twice.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import re
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import aiohttp
from guard_process import KEY, GuardProcess
from sections import Section, quantile

ROOT = Path(__file__).resolve().parents[1]
FRAME_BYTES = 200
RATE_HZ = 100
COUNT = 2000
WARM_UP = 50
PASSES = 2
AIM_MS = 0.2
FENCE = 1
PORT = re.compile(rb"rosbridge listens on [^:]+:(\d+)")


@dataclass(frozen=True)
class Latency:
    """Round trips in ms, and how long the guard's process took until it listened."""

    straight_ms: list[float]
    guarded_ms: list[float]
    ready_s: float

    def added_ms(self, part: float) -> float:
        """What the guard adds at a quantile."""
        return quantile(self.guarded_ms, part) - quantile(self.straight_ms, part)


@asynccontextmanager
async def simulated_robot() -> AsyncIterator[int]:
    """The simulated robot as a process; its rosbridge's port."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "sim_robot",
        cwd=ROOT / "images" / "sim_robot",
        env={
            **os.environ,
            "SIM_BIND_ADDRESS": "127.0.0.1",
            "SIM_ROSBRIDGE_PORT": "0",
            "SIM_VIDEO_PORT": "0",
        },
        stderr=asyncio.subprocess.PIPE,
    )
    assert process.stderr is not None
    try:
        found = None
        while found is None:
            line = await asyncio.wait_for(process.stderr.readline(), 10)
            assert line, "the simulated robot ended"
            found = PORT.search(line)
        yield int(found.group(1))
    finally:
        process.terminate()
        await process.communicate()


class Route:
    """One connection, its own topic, and the round trips on it."""

    def __init__(self, name: str, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.topic = f"/latency_{name}"
        self.times_ms: list[float] = []
        self._socket = socket

    async def open(self) -> None:
        """Subscribe to what it will publish."""
        for op in ("advertise", "subscribe"):
            await self._socket.send_json({"op": op, "topic": self.topic, "type": "std_msgs/String"})

    async def round_trip(self, number: int) -> None:
        """Send one message of FRAME_BYTES and wait until it is back."""
        empty = json.dumps({"op": "publish", "topic": self.topic, "msg": {"data": ""}})
        frame = empty.replace('""', f'"{number:<{FRAME_BYTES - len(empty)}}"')
        started = time.perf_counter()
        await self._socket.send_str(frame)
        answer = await self._socket.receive_str(timeout=5)
        self.times_ms.append((time.perf_counter() - started) * 1000)
        assert json.loads(answer)["msg"]["data"].strip() == str(number)


async def compare(count: int = COUNT, rate_hz: float = RATE_HZ) -> Latency:
    """Make `count` round trips each way."""
    async with AsyncExitStack() as stack:
        port = await stack.enter_async_context(simulated_robot())
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        guard = await stack.enter_async_context(GuardProcess(folder, port))
        await guard.grant(FENCE)
        http = await stack.enter_async_context(aiohttp.ClientSession())
        headers = {
            "Robotether-Key": KEY,
            "Robotether-Mode": "drive",
            "Robotether-Fence": str(FENCE),
        }
        routes = []
        for name, to in (("straight", port), ("guarded", guard.port)):
            socket = await stack.enter_async_context(
                http.ws_connect(f"ws://127.0.0.1:{to}/", headers=headers, max_msg_size=0)
            )
            routes.append(Route(name, socket))
            await routes[-1].open()
        for number in range(count + WARM_UP):
            period = asyncio.create_task(asyncio.sleep(1 / rate_hz))
            # Neither way is always the first one after the pause, which finds colder caches.
            for route in routes if number % 2 else reversed(routes):
                await route.round_trip(number)
            await period
        straight, guarded = (route.times_ms[WARM_UP:] for route in routes)
        return Latency(straight, guarded, guard.ready_s)


def measure(count: int = COUNT) -> Section:
    """The table for docs/measurements.md."""
    found = asyncio.run(compare(count))
    added = found.added_ms(0.5) / PASSES
    table = ["| route | round trips | p50 ms | p99 ms |", "|---|---|---|---|"]
    for name, values in (
        ("straight to rosbridge", found.straight_ms),
        ("through the guard", found.guarded_ms),
    ):
        row = f"{quantile(values, 0.5):.2f} | {quantile(values, 0.99):.2f}"
        table.append(f"| {name} | {len(values)} | {row} |")
    return Section(
        title="What the guard adds to a message",
        text=(
            f"A {FRAME_BYTES}-byte publish and its echo at {RATE_HZ} Hz pass the guard twice. It adds {added:.2f} ms "
            f"to a message at p50. It listened {found.ready_s:.2f} s after its start.\n\n"
            f"Aim: at most {AIM_MS} ms."
        ),
        table=table,
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--count", type=int, default=COUNT)
    sys.stdout.write(measure(parser.parse_args().count).markdown)


if __name__ == "__main__":
    main()
