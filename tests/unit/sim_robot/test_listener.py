"""A listener listens, and tells where."""

import aiohttp
import pytest
from aiohttp import web
from sim_robot.listener import Listener


async def _hello(_request: web.Request) -> web.Response:
    return web.Response(text="hello")


def make() -> Listener:
    """A listener that says hello."""
    app = web.Application()
    app.router.add_get("/", _hello)
    return Listener("hello", app)


async def test_free_port_is_told() -> None:
    """With port 0 the real port is known after the start."""
    listener = make()
    await listener.start("127.0.0.1", 0)
    async with aiohttp.ClientSession() as http:
        async with http.get(f"http://127.0.0.1:{listener.port}/") as answer:
            assert await answer.text() == "hello"
        await listener.stop()
        with pytest.raises(aiohttp.ClientConnectorError):
            await http.get(f"http://127.0.0.1:{listener.port}/")


async def test_taken_port_is_an_error() -> None:
    """A second listener on one port fails."""
    first, second = make(), make()
    await first.start("127.0.0.1", 0)
    with pytest.raises(OSError, match="address already in use"):
        await second.start("127.0.0.1", first.port)
    await second.stop()
    await first.stop()
