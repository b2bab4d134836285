"""A process of people at the queue, started by nemesis.py as `python -m paper.requests.people`.

In: a line with the cells, the people and the robots, then `settle`, then `end`. Out: `begun`, and who failed when no
request is open any more. One asks for help, the others answer; who gets no answer from a cell goes to the
next. Some leave when they are offered a request, without a word. What counts is written into the history.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

import uvloop
from robotether_server.relay.http.event_loop import EventLoop

from paper.cells.people import Person, Scene
from paper.client import FAILURES, new_http
from paper.programs import read_line, write_line

ASK_EVERY_S, POLL_EVERY_S = 3.0, 1.0
PRIORITIES = (1, 2, 3)
# How long operators look at an offer, and at the robot.
THINKS_S, HELPS_S = (0.2, 3.0), (1.0, 5.0)
# Part of the offers whose operator leaves, and for how long.
LEAVES_SHARE, GONE_S = 0.25, 25.0
SETTLED_WITHIN_S = 200.0


class QueuePerson(Person):
    async def call(
        self, method: str, path: str, body: Mapping[str, Any] | None = None
    ) -> dict[str, Any] | None:
        try:
            return await self.ask(path, body, method=method)
        except FAILURES:
            self.go_on()
            return None


class Asker(QueuePerson):
    async def run(self) -> None:
        while True:
            robot = self._rng.choice(self._order["robots"])
            body = {"reason": "the nemesis asks", "priority": self._rng.choice(PRIORITIES)}
            request = await self.call("POST", f"/robots/{robot}/requests", body)
            if request is not None:
                self._history.add("request_made", robot=robot, what=str(request["id"]))
            await asyncio.sleep(ASK_EVERY_S)

    async def wait_for_none(self) -> None:
        async with asyncio.timeout(SETTLED_WITHIN_S):
            while True:
                listed = await self.call("GET", "/requests")
                if listed is not None and not listed["requests"]:
                    return
                await asyncio.sleep(POLL_EVERY_S)


class QueueOperator(QueuePerson):
    async def run(self) -> None:
        while True:
            self._history.add("polled", connection=self.name, cell=self.cell.name)
            view = await self.call("PUT", "/queue/me", {"state": "available"})
            if view is not None and view["current"] is not None:
                await self._help(view["current"])
            elif view is not None and view["offer"] is not None:
                await self._answer(view["offer"])
            else:
                await asyncio.sleep(POLL_EVERY_S)

    async def _answer(self, offer: Mapping[str, Any]) -> None:
        if self._rng.random() < LEAVES_SHARE:
            await asyncio.sleep(GONE_S)
            return
        await asyncio.sleep(self._rng.uniform(*THINKS_S))
        accepted = await self.call("POST", f"/requests/{offer['id']}/accept", {})
        if accepted is not None:
            self._note(offer)

    async def _help(self, request: Mapping[str, Any]) -> None:
        self._note(request)
        await asyncio.sleep(self._rng.uniform(*HELPS_S))
        await self.call("POST", f"/requests/{request['id']}/close", {"note": "done"})

    def _note(self, request: Mapping[str, Any]) -> None:
        what = str(request["id"])
        self._history.add("accepted", robot=request["robot"], connection=self.name, what=what)


async def work() -> None:
    order = await read_line()
    async with new_http(force_close=True) as http:
        scene = Scene(order, "people", http)
        asker = Asker(scene, "admin", order["admin"])
        operators = [
            QueueOperator(scene, person["name"], person["token"]) for person in order["operators"]
        ]
        tasks = [asyncio.create_task(operator.run()) for operator in operators]
        asking = asyncio.create_task(asker.run())
        for number, operator in enumerate(operators):
            operator.begin_at(number)
        write_line({"begun": True})
        await read_line()
        asking.cancel()
        await asker.wait_for_none()
        for task in tasks:
            task.cancel()
        ended = await asyncio.gather(*tasks, asking, return_exceptions=True)
        failed = [repr(result) for result in ended if isinstance(result, Exception)]
        write_line({"failed": failed})
        await read_line()
        scene.history.close()
        write_line({"ended": True})


if __name__ == "__main__":
    uvloop.run(work(), loop_factory=EventLoop)
