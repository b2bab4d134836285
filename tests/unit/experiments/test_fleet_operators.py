"""The operators: what they see of the fleet, and what they do until a robot has its message."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import aiohttp
import pytest
from aiohttp import web
from paper.fleet_arrivals import Arrivals
from paper.fleet_operators import Board, Operators

WAIT_S = 20


class Site:
    """A server's double: events as a test wants them, tickets, and robots' doors that hand on what is published."""

    def __init__(self) -> None:
        self.events: asyncio.Queue[tuple[str, object] | None] = asyncio.Queue()
        self.arrivals: Arrivals
        # What becomes of the next connections to robots: an HTTP status, a close code, or nothing, which is good.
        self.refusals: list[int] = []
        self.tickets = 0

    async def tell(self, request: web.Request) -> web.StreamResponse:
        """Server-sent events, until a None."""
        response = web.StreamResponse(headers={"Content-Type": "text/event-stream"})
        await response.prepare(request)
        while event := await self.events.get():
            await response.write(
                f"event: {event[0]}\ndata: {json.dumps(event[1])}\n\n: awake\n\n".encode()
            )
        return response

    async def ticket(self, request: web.Request) -> web.StreamResponse:
        """One for each who asks."""
        asked = await request.json()
        assert asked == {"robot": "one", "mode": "drive"}
        self.tickets += 1
        return web.json_response({"ticket": f"t{self.tickets}"}, status=201)

    async def ros(self, request: web.Request) -> web.StreamResponse:
        """A robot's door."""
        refusal = self.refusals.pop(0) if self.refusals else 0
        if 0 < refusal < 1000:
            return web.Response(status=refusal)
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        if refusal:
            await socket.close(code=refusal)
            return socket
        assert (await socket.receive_json())["op"] == "advertise"
        message = await socket.receive_json()
        self.arrivals.got("one", message["msg"]["data"], 5_000_000_000)
        await socket.receive()
        return socket


@asynccontextmanager
async def running(site: Site) -> AsyncIterator[tuple[Board, Operators]]:
    """The site, a board that follows it, and its operators."""
    app = web.Application()
    app.router.add_get("/api/v1/events", site.tell)
    app.router.add_post("/api/v1/tickets", site.ticket)
    app.router.add_get("/robots/one/ros", site.ros)
    runner = web.AppRunner(app, shutdown_timeout=0.1)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", 0).start()
    url = f"http://127.0.0.1:{runner.addresses[0][1]}"
    async with aiohttp.ClientSession() as http, asyncio.timeout(WAIT_S):
        board = Board(http, url)
        following = asyncio.ensure_future(board.follow())
        try:
            yield board, Operators(http, url, board)
        finally:
            following.cancel()
            await asyncio.gather(following, return_exceptions=True)
            await runner.cleanup()


def robot(name: str, *, online: bool) -> dict[str, object]:
    return {"name": name, "online": online}


async def test_the_board_follows_the_fleet():
    """First all, then each change; a connection that ends is made anew, and nobody is online meanwhile."""
    site = Site()
    async with running(site) as (board, _):
        site.events.put_nowait(("fleet", [robot("one", online=True), robot("two", online=False)]))
        await board.until(["one"], online=True)
        site.events.put_nowait(("robot", robot("two", online=True)))
        await board.until(["one", "two"], online=True)
        site.events.put_nowait(("robot", robot("one", online=False)))
        await board.until(["one"], online=False)
        site.events.put_nowait(("removed", {"name": "two"}))
        await board.until(["one", "two"], online=False)
        site.events.put_nowait(("fleet", [robot("one", online=True)]))
        await board.until(["one"], online=True)
        site.events.put_nowait(None)
        await board.until(["one"], online=False)


@pytest.mark.parametrize(
    ("refusals", "waits"),
    [
        ([], {}),
        ([4503, 4504], {"closed with 4503": 1, "closed with 4504": 1}),
        ([502], {"WSServerHandshakeError": 1}),
    ],
)
async def test_a_message_is_sent_until_it_has_come(refusals, waits):
    """Each try has a ticket of its own, and is counted by what the server said."""
    site = Site()
    site.refusals = refusals
    site.arrivals = Arrivals(["one"], "start-1", 0)
    tries = len(refusals) + 1
    async with running(site) as (_, operators):
        site.events.put_nowait(("fleet", [robot("one", online=True)]))
        await operators.deliver_all(["one"], site.arrivals, WAIT_S)
    values = site.arrivals.values()
    assert values["message_s"] == [5.0]
    assert values["waits"] == waits
    assert site.tickets == tries


async def test_nobody_waits_for_ever():
    """A robot that never is online has no message when the time is over."""
    site = Site()
    site.arrivals = Arrivals(["one"], "start-1", 0)
    async with running(site) as (_, operators):
        await operators.deliver_all(["one"], site.arrivals, 0.2)
    assert site.arrivals.values()["message_s"] == [None]
