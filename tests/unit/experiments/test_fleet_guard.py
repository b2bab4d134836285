"""The guard in the process of its agent: it serves, it obeys, it ends."""

from __future__ import annotations

import asyncio

import aiohttp
import pytest
from paper.bus_robot import BusRobot
from paper.fleet_guard import GuardHere
from robotether_agent.problems import GuardDown

WAIT_S = 20


async def test_it_passes_a_connection_on_and_ends(tmp_path):
    """Ready with a port, joined to rosbridge after its configuration, and gone when it is told to end."""
    lines: asyncio.Queue = asyncio.Queue()
    async with asyncio.timeout(WAIT_S), BusRobot("127.0.0.1", 0) as bus:
        guard = GuardHere(tmp_path, tmp_path)
        serving = asyncio.ensure_future(guard.serve(lines.put_nowait))
        ready = await lines.get()
        url = f"ws://127.0.0.1:{bus.rosbridge.listener.port}"
        guard.send({"type": "config", "rosbridge_url": url, "guard": {}, "direct": True})
        guard.send({"type": "session", "up": True})
        async with aiohttp.ClientSession() as http, await _connected(http, ready["port"]) as socket:
            asked = {"op": "call_service", "id": "1", "service": "/rosapi/topics"}
            await socket.send_json(asked)
            assert (await socket.receive_json())["id"] == "1"
        await guard.end()
        with pytest.raises(GuardDown):
            await serving


async def test_it_can_be_killed(tmp_path):
    """Whoever serves it hears that there is no guard any more."""
    async with asyncio.timeout(WAIT_S):
        guard = GuardHere(tmp_path, tmp_path)
        serving = asyncio.ensure_future(guard.serve(lambda _: None))
        await guard.kill()
        with pytest.raises(GuardDown):
            await serving


async def _connected(http: aiohttp.ClientSession, port: int) -> aiohttp.ClientWebSocketResponse:
    """The guard takes its orders a moment after it listens."""
    while True:
        try:
            return await http.ws_connect(f"ws://127.0.0.1:{port}")
        except aiohttp.WSServerHandshakeError:  # noqa: PERF203
            await asyncio.sleep(0.05)
