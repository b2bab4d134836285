"""The ROS side without a robot answers as rosbridge does, and an operator's sockets are made inside the uplink."""

from __future__ import annotations

import aiohttp
import pytest
from aiohttp import web
from link import why_not_here
from local_network import free_port
from paper.bus_robot import BusRobot
from paper.operator import connector
from paper.profiles import PLAIN
from paper.uplinks import uplinks


async def test_what_is_published_comes_back() -> None:
    """By a subscription of the same connection, and rosapi lists the topic."""
    port = free_port()
    async with (
        BusRobot("127.0.0.1", port),
        aiohttp.ClientSession() as http,
        http.ws_connect(f"ws://127.0.0.1:{port}") as client,
    ):
        topic = {"topic": "/x", "type": "std_msgs/String"}
        await client.send_json({"op": "subscribe", **topic})
        await client.send_json({"op": "publish", **topic, "msg": {"data": "here"}})
        assert (await client.receive_json(timeout=5))["msg"] == {"data": "here"}
        await client.send_json({"op": "call_service", "service": "/rosapi/topics"})
        assert "/x" in (await client.receive_json(timeout=5))["values"]["topics"]


@pytest.mark.skipif(bool(why_not_here()), reason=why_not_here() or "-")
async def test_a_server_sees_the_operator_at_the_uplinks_address() -> None:
    """Though all of the program but its sockets is outside."""

    async def tell(request: web.Request) -> web.Response:
        return web.Response(text=request.remote)

    app = web.Application()
    app.router.add_get("/", tell)
    runner = web.AppRunner(app)
    await runner.setup()
    port = free_port()
    await web.TCPSite(runner, "0.0.0.0", port).start()
    try:
        with uplinks([PLAIN], "") as [uplink]:
            async with aiohttp.ClientSession(connector=connector(uplink)) as http:
                answer = await http.get(f"http://{gateway_of(uplink.inside.address)}:{port}")
                assert await answer.text() == uplink.inside.address
    finally:
        await runner.cleanup()


def gateway_of(inside: str) -> str:
    """This machine's end of the cable."""
    before, _, last = inside.rpartition(".")
    return f"{before}.{int(last) - 1}"
