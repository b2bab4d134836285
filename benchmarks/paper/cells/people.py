"""A process of drivers, observers and operators, started by workload.py as `python -m paper.cells.people`.

In: a line with the cells, the people and the robots, then `settle`, then `end`. Out: `begun`, what they have seen
until `settle`, and `settled` when each operator has had its last word on each of its robots. All choose robots and
cells by the seed; whoever loses a connection goes to the next cell by itself, with a fresh ticket. What counts is
written into the history.
"""

from __future__ import annotations

import asyncio
import time
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import aiohttp
import uvloop
from report import quantiles
from robotether_server.relay.http.event_loop import EventLoop

from paper.cells.history import History
from paper.client import (
    CLOSE_S,
    FAILURES,
    TOPIC,
    TYPE,
    Client,
    Echoes,
    RefusedError,
    command,
    new_http,
    words_of,
)
from paper.programs import read_line, write_line

# A stop is answered within 1 s, a release within 2 s, by a cell that must ask another one.
ORDER_S = 5.0
# Time without a heard command after which a driver goes to the next cell; the first is longer, as the robot has to
# open a connection for its topics.
SILENT_S, FIRST_S = 1.0, 3.0
AGAIN_S, STOPPED_AGAIN_S = 0.1, 0.5
# How long one drives a robot; who cannot, waits that much longer before it gives up.
DRIVE_S, TIMEOUT_S = (6.0, 15.0), 60.0
# A few robots are what several drivers want.
HOT_SHARE = 0.6
BETWEEN_STOPS_S, STOPPED_FOR_S = (2.0, 6.0), (0.3, 2.0)
LAST_STOPS = 60
# In which times of stops are shown.
RESOLUTION_S = 1.0
RECORD_EVERY_S = 0.5
OBSERVE_S = (20.0, 60.0)
STOPPED_CODE, HELD_CODES = 4003, (4009, 4010)
# Names of a driver's connections: so many of each.
CONNECTIONS_A_DRIVER = 10_000


@dataclass(frozen=True)
class CellAddress:
    name: str
    address: str


class Scene:
    """What all people share: cells and robots, as the order has them, and the history."""

    def __init__(self, order: Mapping[str, Any], source: str, http: aiohttp.ClientSession) -> None:
        self.order = order
        self.http = http
        self.cells = [CellAddress(**cell) for cell in order["cells"]]
        self.history = History.open(Path(order["folder"]), source)


class Person(Client, ABC):
    """Somebody with a token, at one cell after the other, who chooses by the seed."""

    def __init__(self, scene: Scene, name: str, token: str) -> None:
        super().__init__(scene.http, "", token)
        self.name = name
        self._order, self._history = scene.order, scene.history
        self._rng = Random(f"{scene.order['seed']} {name}")
        self._cells = scene.cells
        self._at = 0

    @abstractmethod
    async def run(self) -> None:
        pass

    @property
    def cell(self) -> CellAddress:
        return self._cells[self._at]

    @property
    def address(self) -> str:
        return self.cell.address

    def begin_at(self, number: int) -> None:
        self._at = number % len(self._cells)

    def go_on(self) -> None:
        self._at = (self._at + 1) % len(self._cells)


class Driver(Person):
    def __init__(self, number: int, *person: Any) -> None:
        super().__init__(*person)
        self.begin_at(number)
        self._dials = number * CONNECTIONS_A_DRIVER
        self.sent = 0
        self.round_trips_ms: list[float] = []

    async def run(self) -> None:
        while True:
            which = "hot" if self._rng.random() < HOT_SHARE else "robots"
            robot = self._rng.choice(self._order[which])
            self._history.add("wants", robot=robot, what=self.name)
            try:
                await self._drive(robot, self._rng.uniform(*DRIVE_S))
            finally:
                self._history.add("leaves", robot=robot, what=self.name)

    async def _drive(self, robot: str, seconds: float) -> None:
        """Drive for so long, by as many connections as it takes; give up when somebody else does."""
        began = time.monotonic()
        end, latest = began + seconds, began + seconds + TIMEOUT_S
        while time.monotonic() < end:
            echoes = Echoes(round_trips_ms=self.round_trips_ms)
            try:
                await self._connection(robot, end, echoes)
            except FAILURES as error:
                what = f"{self.name}: {words_of(error)}"
                self._history.add("refused", robot=robot, cell=self.cell.name, what=what)
                code = error.code if isinstance(error, RefusedError) else 0
                if code in HELD_CODES:
                    return
                if code == STOPPED_CODE:
                    await asyncio.sleep(STOPPED_AGAIN_S)
                    continue
                self.go_on()
                if not echoes.count:
                    # Until it is driven, who wants to drive it stays.
                    end = min(max(end, time.monotonic() + DRIVE_S[0]), latest)
                await asyncio.sleep(AGAIN_S)

    async def _connection(self, robot: str, end: float, echoes: Echoes) -> None:
        period_s = 1 / self._order["rate_hz"]
        socket = await self.connect(robot, straight=self._rng.random() < 0.5)
        self._dials += 1
        async with echoes.listening(socket, self._dials) as listening:
            echoes.at_s = due = time.monotonic()
            number = 0
            while time.monotonic() < end:
                if listening.done():
                    raise RefusedError(f"closed with {socket.close_code}", socket.close_code or 0)
                if time.monotonic() - echoes.at_s > (SILENT_S if echoes.count else FIRST_S):
                    raise RefusedError("no command is heard")
                await self._send(socket, listening, echoes, number)
                number += 1
                due = max(due + period_s, time.monotonic() - period_s)
                await asyncio.sleep(due - time.monotonic())

    async def _send(
        self,
        socket: aiohttp.ClientWebSocketResponse,
        listening: asyncio.Task[None],
        echoes: Echoes,
        number: int,
    ) -> None:
        echoes.sent_at[number] = time.monotonic()
        try:
            # No wait_for, which before Python 3.12 may lose a cancellation.
            async with asyncio.timeout(SILENT_S):
                await socket.send_json(command(number, self._dials))
        except ConnectionError:
            # It says why, if the other end has.
            await asyncio.wait({listening}, timeout=CLOSE_S)
            raise RefusedError(f"closed with {socket.close_code}", socket.close_code or 0) from None
        self.sent += 1


class Leader(Driver):
    async def run(self) -> None:
        while True:
            await self._drive(self._order["source"], self._rng.uniform(*DRIVE_S))
            await asyncio.sleep(AGAIN_S)


class Observer(Person):
    """Watches one robot after the other; those with a camera by their video, too."""

    frames = messages = 0

    async def run(self) -> None:
        self.begin_at(self._rng.randrange(len(self._cells)))
        cameras = self._order["cameras"]
        while True:
            robot = self._rng.choice(cameras or self._order["robots"])
            with suppress(TimeoutError):
                async with asyncio.timeout(self._rng.uniform(*OBSERVE_S)):
                    await asyncio.gather(
                        self._again(partial(self._topic, robot)),
                        *[self._again(partial(self._video, robot))] * (robot in cameras),
                    )

    async def _again(self, watch: Callable[[], Awaitable[None]]) -> None:
        while True:
            try:
                await watch()
            except FAILURES:
                self.go_on()
            await asyncio.sleep(STOPPED_AGAIN_S)

    async def _topic(self, robot: str) -> None:
        async with await self.connect(robot, "observe") as socket:
            await socket.send_json({"op": "subscribe", "topic": TOPIC, "type": TYPE})
            async for _ in socket:
                self.messages += 1
            raise RefusedError(f"closed with {socket.close_code}")

    async def _video(self, robot: str) -> None:
        path = "video/frames?topic=/camera/image_raw"
        async with await self.connect(robot, "observe", path) as socket:
            await socket.send_json({"op": "stream_request"})
            await socket.send_json({"op": "credit", "frames": 2, "taken": None})
            async for message in socket:
                if message.type is aiohttp.WSMsgType.BINARY:
                    self.frames += 1
                    await socket.send_json({"op": "credit", "frames": 1, "taken": None})
            raise RefusedError(f"closed with {socket.close_code}")


class Operator(Person):
    """Stops robots of its own and releases them, each request at any cell."""

    def __init__(self, robots: Sequence[str], *person: Any) -> None:
        super().__init__(*person)
        self.robots = robots
        self._numbers = 0
        self.confirmed = 0

    async def run(self) -> None:
        while True:
            await asyncio.sleep(self._rng.uniform(*BETWEEN_STOPS_S))
            robot = self._rng.choice(self.robots)
            await self.stop(robot)
            await asyncio.sleep(self._rng.uniform(*STOPPED_FOR_S))
            await self.release(robot)

    async def settle(self) -> None:
        """Have the last word: every second robot stays stopped."""
        for at, robot in enumerate(self.robots):
            await self.release(robot)
            if at % 2:
                await self._stop_for_sure(robot)

    async def _stop_for_sure(self, robot: str) -> None:
        for _ in range(LAST_STOPS):
            if await self.stop(robot):
                return
            await asyncio.sleep(STOPPED_AGAIN_S)
        raise RuntimeError(f"{robot} did not confirm a stop, and nothing is broken any more")

    async def stop(self, robot: str) -> bool:
        self.begin_at(self._rng.randrange(len(self._cells)))
        self._numbers += 1
        reason = f"{self.name} {self._numbers}"
        self._history.add("stop_asked", robot=robot, connection=self.name, cell=self.cell.name)
        asked_at = time.time()
        answer = await self._ask(robot, "stop", {"reason": reason})
        if answer is None:
            return False
        stopped = answer.get("stopped") or {}
        confirmed = bool(stopped.get("confirmed"))
        self.confirmed += confirmed
        self._history.add(
            "stop_done",
            robot=robot,
            connection=self.name,
            cell=self.cell.name,
            number=int(confirmed),
            what=reason if self._is_own(stopped, asked_at) else "",
        )
        return confirmed

    def _is_own(self, stopped: Mapping[str, Any], asked_at: float) -> bool:
        if stopped.get("by") != self.name:
            return False
        return datetime.fromisoformat(stopped["at"]).timestamp() >= asked_at - RESOLUTION_S

    async def release(self, robot: str) -> None:
        while True:
            self.begin_at(self._rng.randrange(len(self._cells)))
            where = {"connection": self.name, "cell": self.cell.name}
            self._history.add("release_asked", robot=robot, **where)
            if await self._ask(robot, "release", {}) is not None:
                self._history.add("release_done", robot=robot, **where)
                return
            await asyncio.sleep(STOPPED_AGAIN_S)

    async def _ask(
        self, robot: str, what: str, body: Mapping[str, Any]
    ) -> Mapping[str, Any] | None:
        with suppress(*FAILURES):
            return await self.ask(f"/robots/{robot}/{what}", body, within_s=ORDER_S)
        return None


class Recorder(Person):
    async def run(self) -> None:
        number = 0
        while True:
            await asyncio.sleep(RECORD_EVERY_S)
            self.go_on()
            number += 1
            name = f"{self._order['prefix']}-{number}"
            try:
                await self.ask("/sites", {"name": name})
            except FAILURES:
                continue
            self._history.add("recorded", what=name, cell=self.cell.name)


async def work() -> None:
    order = await read_line()
    async with new_http(force_close=True) as http:
        scene = Scene(order, "people", http)
        some_drivers, some_observers, some_operators = (
            [(scene, person["name"], person["token"]) for person in order[kind]]
            for kind in ("drivers", "observers", "operators")
        )
        admin = (scene, "admin", order["admin"])
        drivers = [Driver(number, *person) for number, person in enumerate(some_drivers, 1)]
        drivers.append(Leader(len(drivers) + 1, *admin))
        observers = [Observer(*person) for person in some_observers]
        operators = [
            Operator(order["hot"][number :: len(some_operators)], *person)
            for number, person in enumerate(some_operators)
        ]
        people = [*drivers, *observers, *operators, Recorder(*admin)]
        tasks = [asyncio.create_task(person.run()) for person in people]
        write_line({"begun": True})
        await read_line()
        for task in tasks:
            task.cancel()
        ended = await asyncio.gather(*tasks, return_exceptions=True)
        trips_ms = [ms for driver in drivers for ms in driver.round_trips_ms]
        seen = {
            "sent": sum(driver.sent for driver in drivers),
            "heard": len(trips_ms),
            "p99_ms": quantiles(trips_ms, 0.99, unit="ms")["p99, ms"],
            "frames": sum(observer.frames for observer in observers),
            "messages": sum(observer.messages for observer in observers),
            "confirmed_stops": sum(operator.confirmed for operator in operators),
            "failed": [repr(result) for result in ended if isinstance(result, Exception)],
        }
        write_line(seen)
        await asyncio.gather(*(operator.settle() for operator in operators))
        write_line({"settled": True})
        # The database is read meanwhile.
        await read_line()
        for operator in operators:
            for robot in operator.robots:
                await operator.release(robot)
        scene.history.close()
        write_line({"ended": True})


if __name__ == "__main__":
    uvloop.run(work(), loop_factory=EventLoop)
