"""A process that drives many robots at once, started by density.py as `python -m paper.density.drivers`.

In: a line with the robots and how they are driven. Out: "ready" when each has its lease, and after the line "begin"
what each driver saw. A command counts as lost when it is not heard within two seconds of the last one. Each connection
is dialled again and counted when it ends before.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import aiohttp
import uvloop

from paper.client import FAILURES, Client, Echoes, begin, close, command, new_http
from paper.programs import read_line, write_line

READY_WITHIN_S, AGAIN_S, LAST_WITHIN_S = 60.0, 0.2, 2.0
# Number of commands that do not count.
BEFORE = -1
# A busy server answers late, and is asked again then.
REQUEST_S = 20.0


class Driver:
    """One operator with one robot; figures of agents and virtual robots are kept apart by its kind."""

    def __init__(
        self, http: aiohttp.ClientSession, site: str, robot: str, token: str, kind: str
    ) -> None:
        self._robot, self._kind = robot, kind
        self._client = Client(http, site, token, REQUEST_S)
        self._socket: aiohttp.ClientWebSocketResponse
        self._echoes = Echoes()
        self._sent = 0
        self._unsent = 0
        # How long after its time each command was sent; a busy machine makes this process late, too.
        self._late_ms: list[float] = []
        self._endings: Counter[str] = Counter()
        self._listening: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Have the lease, and be heard; listen from now on: a client that answers no ping drives with old commands."""
        await self._dial()
        self._listening = asyncio.create_task(self._keep_listening())
        # The robot opens a connection for topics when somebody listens.
        async with asyncio.timeout(READY_WITHIN_S):
            while not self._echoes.count:
                with suppress(ConnectionError):
                    await self._socket.send_json(command(BEFORE))
                await asyncio.sleep(AGAIN_S)
        self._echoes.refused.clear()

    async def _dial(self) -> None:
        async with asyncio.timeout(READY_WITHIN_S):
            while True:
                with suppress(*FAILURES):
                    self._socket = await self._client.connect(self._robot)
                    return await begin(self._socket)
                await asyncio.sleep(AGAIN_S)

    async def run(self, begin_s: float, rate_hz: float, seconds: float) -> None:
        for number in range(int(rate_hz * seconds)):
            due_s = begin_s + number / rate_hz
            await asyncio.sleep(due_s - time.monotonic())
            self._late_ms.append(round(max(0.0, time.monotonic() - due_s) * 1000, 2))
            await self._send(number)
        with suppress(TimeoutError):
            async with asyncio.timeout(LAST_WITHIN_S):
                await self._echoes.until_all_came()

    def result(self) -> Mapping[str, Any]:
        return {
            "robot": self._robot,
            "kind": self._kind,
            "sent": self._sent,
            "unsent": self._unsent,
            "lost": len(self._echoes.sent_at),
            "endings": dict(self._endings),
            "refused": dict(self._echoes.refused),
            "round_trips_ms": self._echoes.round_trips_ms,
            "late_ms": self._late_ms,
        }

    async def close(self) -> None:
        if self._listening is not None:
            self._listening.cancel()
            await asyncio.gather(self._listening, return_exceptions=True)
        await close(self._socket)

    async def _send(self, number: int) -> None:
        sent_at = time.monotonic()
        try:
            await self._socket.send_json(command(number))
        except ConnectionError:
            self._unsent += 1
            return
        self._sent += 1
        self._echoes.sent_at[number] = sent_at

    async def _keep_listening(self) -> None:
        while True:
            await self._echoes.listen(self._socket)
            self._endings[f"close code {self._socket.close_code}"] += 1
            await self._dial()


async def work() -> None:
    order = await read_line()
    rate_hz, seconds = order["rate_hz"], order["seconds"]
    async with new_http() as http:
        drivers = [Driver(http, order["site"], **drive) for drive in order["drives"]]
        await asyncio.gather(*(driver.open() for driver in drivers))
        write_line({"ready": True})
        await read_line()
        began, cpu_s = time.monotonic(), time.process_time()
        # Not in step, as operators are not.
        step_s = 1 / rate_hz / len(drivers)
        runs = (
            driver.run(began + 0.1 + number * step_s, rate_hz, seconds)
            for number, driver in enumerate(drivers)
        )
        await asyncio.gather(*runs)
        write_line(
            {
                "drives": [driver.result() for driver in drivers],
                "cpu_s": round(time.process_time() - cpu_s, 3),
                "took_s": round(time.monotonic() - began, 3),
            }
        )
        await asyncio.gather(*(driver.close() for driver in drivers))


if __name__ == "__main__":
    uvloop.run(work())
