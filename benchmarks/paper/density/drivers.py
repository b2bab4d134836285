"""A process that drives many robots at once, started by density.py as `python -m paper.density.drivers`.

In: a line with the robots and how they are driven. Out: "ready" when each has its lease, and after the line "begin"
what each driver saw. A driver publishes a numbered Twist on /cmd_vel at a fixed rate, as a page does, and subscribes
to the same topic: what it hears has passed relay, sshd and the robot's guard and rosbridge, and the same way back. A
command counts as lost when it is not heard within two seconds of the last one. Each connection is dialled again and
counted when it ends before.
"""

from __future__ import annotations

import asyncio
import json
import re
import sys
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import aiohttp
import uvloop
from local_network import insecure_tls

from paper.numbered.messages import Histogram
from paper.programs import write_line

TOPIC, TYPE = "/cmd_vel", "geometry_msgs/Twist"
SPEED_M_S = 0.2
READY_WITHIN_S, AGAIN_S, LAST_WITHIN_S = 60.0, 0.2, 2.0
MS_PER_S = 1000.0
# The number of a command travels in a component that nothing limits; so many of them are exact.
PER_UNIT = 1000.0
MAX_WORDS = 80
_NUMBER = re.compile(r"\d+")


@dataclass(frozen=True)
class Drive:
    """One robot to drive, as JSON carries it."""

    robot: str
    token: str
    # "agent" or "virtual": figures are kept apart.
    kind: str


class Driver:
    """One operator with one robot."""

    def __init__(self, drive: Drive, site: str, http: aiohttp.ClientSession) -> None:
        self.drive = drive
        self._site, self._http = site, http
        self._socket: aiohttp.ClientWebSocketResponse
        self._under_way: dict[int, float] = {}
        self._came = asyncio.Event()
        self._sent = 0
        self._unsent = 0
        self.round_trips = Histogram()
        # How long after its time each command was sent; a busy machine makes this process late, too.
        self._late = Histogram()
        self._endings: Counter[str] = Counter()
        # What relay or guard did not pass on, by their words without what differs each time.
        self._refused: Counter[str] = Counter()
        self._listening: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Have the lease, and listen from now on: a client that answers no ping drives with old commands."""
        await self.dial_first()
        self._listening = asyncio.create_task(self._keep_listening())

    async def dial_first(self) -> None:
        """Have the lease, trying again for a while."""
        async with asyncio.timeout(READY_WITHIN_S):
            while True:
                with suppress(aiohttp.ClientError, OSError):
                    return await self.dial()
                await asyncio.sleep(AGAIN_S)

    async def dial(self) -> None:
        wanted = {"robot": self.drive.robot, "mode": "drive"}
        headers = {"Authorization": f"Bearer {self.drive.token}"}
        tickets = f"https://{self._site}/api/v1/tickets"
        async with self._http.post(tickets, json=wanted, headers=headers) as answer:
            answer.raise_for_status()
            ticket = (await answer.json())["ticket"]
        url = f"https://{self._site}/robots/{self.drive.robot}/ros?ticket={ticket}"
        self._socket = await self._http.ws_connect(url, compress=0)
        for op in ("advertise", "subscribe"):
            await self._socket.send_json({"op": op, "topic": TOPIC, "type": TYPE})

    async def run(self, begin_s: float, rate_hz: float, seconds: float) -> None:
        """Drive from then on for so long, and wait for the last answers."""
        for number in range(int(rate_hz * seconds)):
            due_s = begin_s + number / rate_hz
            await asyncio.sleep(due_s - time.monotonic())
            self._late.add(max(0.0, time.monotonic() - due_s) * MS_PER_S)
            await self._send(number)
        with suppress(TimeoutError):
            async with asyncio.timeout(LAST_WITHIN_S):
                await self._until_all_came()

    async def _until_all_came(self) -> None:
        while self._under_way:
            self._came.clear()
            await self._came.wait()

    def result(self) -> Mapping[str, Any]:
        return {
            "robot": self.drive.robot,
            "kind": self.drive.kind,
            "sent": self._sent,
            "unsent": self._unsent,
            "lost": len(self._under_way),
            "endings": dict(self._endings),
            "refused": dict(self._refused),
            "round_trips": self.round_trips.as_json(),
            "late": self._late.as_json(),
        }

    async def close(self) -> None:
        if self._listening is not None:
            self._listening.cancel()
            await asyncio.gather(self._listening, return_exceptions=True)
        with suppress(TimeoutError):
            async with asyncio.timeout(2):
                await self._socket.close()

    async def _send(self, number: int) -> None:
        twist = {
            "linear": {"x": SPEED_M_S, "y": 0.0, "z": 0.0},
            "angular": {"x": number / PER_UNIT, "y": 0.0, "z": 0.0},
        }
        text = json.dumps({"op": "publish", "topic": TOPIC, "msg": twist})
        sent_at = time.monotonic()
        try:
            await self._socket.send_str(text)
        except ConnectionError:
            self._unsent += 1
            return
        self._sent += 1
        self._under_way[number] = sent_at

    async def _keep_listening(self) -> None:
        while True:
            await self._listen()
            self._endings[f"close code {self._socket.close_code}"] += 1
            await self.dial_first()

    async def _listen(self) -> None:
        async for frame in self._socket:
            if frame.type is not aiohttp.WSMsgType.TEXT:
                continue
            said = json.loads(frame.data)
            if said.get("op") == "publish":
                # Zeros have no number that is under way but that of the first command.
                number = round(said["msg"]["angular"]["x"] * PER_UNIT)
                moves = said["msg"]["linear"]["x"]
                sent_at = self._under_way.pop(number, None) if moves else None
                if sent_at is not None:
                    self._came.set()
                    self.round_trips.add((time.monotonic() - sent_at) * MS_PER_S)
            elif said.get("op") == "status":
                self._refused[_NUMBER.sub("N", said.get("msg", ""))[:MAX_WORDS]] += 1


async def work() -> None:
    order = json.loads(await asyncio.to_thread(sys.stdin.readline))
    rate_hz, seconds = order["rate_hz"], order["seconds"]
    connector = aiohttp.TCPConnector(ssl=insecure_tls(), limit=0)
    async with aiohttp.ClientSession(connector=connector) as http:
        drivers = [Driver(Drive(**one), order["site"], http) for one in order["drives"]]
        await asyncio.gather(*(driver.open() for driver in drivers))
        write_line({"ready": True})
        await asyncio.to_thread(sys.stdin.readline)
        began, cpu_s = time.monotonic(), time.process_time()
        # Not in step, as operators are not.
        begins = [began + 0.1 + at / rate_hz / len(drivers) for at in range(len(drivers))]
        runs = (one.run(at, rate_hz, seconds) for one, at in zip(drivers, begins, strict=True))
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
