"""A robot does not lead the relay anywhere else."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest
from aiohttp import ClientSession, web
from aiohttp.test_utils import TestServer
from robotether_server.relay.http.redirects import RedirectedError, refuse_redirects


class Elsewhere:
    """A server that counts who comes, and one that sends everybody there."""

    def __init__(self) -> None:
        self.visits = 0

    async def visit(self, _request: web.Request) -> web.Response:
        self.visits += 1
        return web.Response()


@pytest.fixture
async def elsewhere() -> AsyncIterator[tuple[Elsewhere, TestServer]]:
    counting, app = Elsewhere(), web.Application()
    app.router.add_get("/", counting.visit)
    async with TestServer(app) as server:
        yield counting, server


@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
async def test_a_redirect_is_not_followed(elsewhere, status):
    """Neither by a request nor when a WebSocket opens."""
    counting, target = elsewhere

    async def redirect(_request: web.Request) -> web.Response:
        return web.Response(status=status, headers={"Location": str(target.make_url("/"))})

    app = web.Application()
    app.router.add_get("/", redirect)
    async with (
        TestServer(app) as robot,
        ClientSession(trace_configs=[refuse_redirects()]) as client,
    ):
        with pytest.raises(RedirectedError):
            await client.ws_connect(robot.make_url("/"))
        with pytest.raises(RedirectedError):
            await client.get(robot.make_url("/"))
        assert (await client.get(target.make_url("/"))).status == 200
    assert counting.visits == 1
