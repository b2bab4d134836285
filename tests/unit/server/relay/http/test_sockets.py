"""The two ends of a bridge, over real sockets with peers that behave badly."""

import asyncio
import time
from contextlib import asynccontextmanager
from typing import cast

import aiohttp
import pytest
from aiohttp import ClientSession, WSMsgType, web
from fake_robot import HOST, WAIT_S
from relay_clients import closing, counted_turns
from relay_server import until
from robotether_server.relay.http import event_loop
from robotether_server.relay.http import sockets as module
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.http.event_loop import PieceTurns
from robotether_server.relay.http.sockets import (
    NEVER_SENT,
    OperatorSocket,
    RedirectedError,
    RobotSocket,
    refuse_redirects,
)

OFFLINE = CloseReason("robot_offline", "robot sim1 is offline")


@asynccontextmanager
async def serving(handler):
    app = web.Application()
    app.router.add_get("/", handler)
    runner = web.AppRunner(app, access_log=None, handler_cancellation=True, shutdown_timeout=0.1)
    await runner.setup()
    await web.TCPSite(runner, HOST, 0).start()
    try:
        yield f"http://{HOST}:{runner.addresses[0][1]}/"
    finally:
        await runner.cleanup()


@pytest.fixture
def operator(http):
    @asynccontextmanager
    async def connected(talk):
        async def handle(request):
            socket = OperatorSocket(message_limit=1000)
            await socket.open(request)
            await talk(socket)
            return socket

        async with (
            serving(handle) as url,
            http.ws_connect(url, autoclose=False, autoping=False) as client,
        ):
            yield client

    return connected


def transport_of(client):
    transport = client._response.connection.transport
    assert transport is not None
    return transport


@pytest.mark.parametrize(
    "talk",
    [
        lambda socket: socket.close(code=1000, message=b"aiohttp's own"),
        lambda socket: socket.finish(CloseReason(NEVER_SENT, "x", "x")),
    ],
)
async def test_what_is_no_goodbye_cuts(operator, talk):
    """What aiohttp closes by itself is no close frame: it would have the wrong reason."""
    async with operator(talk) as client:
        message = await client.receive(timeout=WAIT_S)
        assert message.type is not WSMsgType.CLOSE
        assert client.close_code == NEVER_SENT


async def test_a_client_that_does_not_answer_the_close_is_cut(operator, monkeypatch):
    monkeypatch.setattr(module, "OPERATOR_FAREWELL_S", 0.2)
    lasted = asyncio.get_running_loop().create_future()

    async def talk(socket):
        began_s = time.monotonic()
        await socket.finish(OFFLINE)
        lasted.set_result(time.monotonic() - began_s)

    async with operator(talk) as client:
        assert (await closing(client))[0] == OFFLINE.code
        assert 0.1 < await asyncio.wait_for(lasted, WAIT_S) < 5
        await until(transport_of(client).is_closing, "the connection is cut")


async def test_a_client_that_floods_until_its_end_holds_nobody_up(operator, monkeypatch):
    """Between its messages, which the close waits behind, others have a turn."""
    monkeypatch.setattr(module, "OPERATOR_FAREWELL_S", 0.5)
    sent, seen, receive = asyncio.Event(), [], OperatorSocket.receive

    async def finishes(socket):
        await sent.wait()
        await asyncio.sleep(0.1)
        await socket.finish(OFFLINE)

    async with operator(finishes) as client, counted_turns() as turns:
        monkeypatch.setattr(
            OperatorSocket, "receive", lambda *args: seen.append(turns()) or receive(*args)
        )
        # Pongs, masked with zeros.
        transport_of(client).write(b"\x8a\x80\0\0\0\0" * 1000)
        sent.set()
        await until(lambda: len(seen) > 1000, "all are read")
    assert len(set(seen)) > 100


async def unresponsive(request):
    """Accept, then neither read nor write, as a robot that hangs."""
    socket = web.WebSocketResponse()
    await socket.prepare(request)
    await asyncio.Event().wait()
    return socket


async def test_a_robot_that_does_not_answer_is_left_in_time(monkeypatch):
    """It gives its connection back, which is the only one."""
    monkeypatch.setattr(module, "ROBOT_FAREWELL_S", 0.2)
    connector = aiohttp.TCPConnector(limit=1, force_close=True)
    kind = cast(type[aiohttp.ClientWebSocketResponse], RobotSocket)
    async with (
        serving(unresponsive) as url,
        aiohttp.ClientSession(connector=connector, ws_response_class=kind) as session,
    ):
        for _ in range(2):
            async with asyncio.timeout(WAIT_S):
                socket = cast(RobotSocket, await session.ws_connect(url))
            async with asyncio.timeout(5):
                await socket.leave()
            assert socket.waiting_bytes() == 0
            socket.drop()


@pytest.fixture
def large_turns(monkeypatch):
    """Turns of some ms, so that much happens between two pieces."""
    monkeypatch.setattr(event_loop, "LARGE_BYTES_PER_S", 16 * 1024 * 1024)
    return PieceTurns()


async def test_what_is_sent_meanwhile_comes_behind_a_large_message(operator, large_turns):
    """A frame inside it would break the protocol; until the whole is sent, all of it counts as waiting."""
    data, waiting = "x" * 1_000_000, []

    async def talk(socket):
        large = asyncio.create_task(socket.send_large(data.encode(), WSMsgType.TEXT, large_turns))
        await asyncio.sleep(0.01)
        waiting.append(socket.waiting_bytes())
        parts = (socket.send_frame(b"small", WSMsgType.TEXT), socket.ping(b"1"), socket.pong(b"2"))
        await asyncio.gather(large, *parts)
        waiting.append(socket.waiting_bytes())
        await socket.finish(OFFLINE)

    async with operator(talk) as client:
        received = [await client.receive(timeout=WAIT_S) for _ in range(4)]
        assert await closing(client) == (OFFLINE.code, OFFLINE.reason)
    assert [each.data for each in received] == [data, "small", b"1", b"2"]
    assert waiting[0] > len(data) // 2
    assert waiting[1] == 0


async def test_the_reason_arrives_behind_a_large_message_that_is_cut_short(operator, large_turns):
    """A connection may end at any time, and the client must still read why."""
    data = b"x" * 1_000_000

    async def talk(socket):
        large = asyncio.create_task(socket.send_large(data, WSMsgType.BINARY, large_turns))
        await asyncio.sleep(0.01)
        large.cancel()
        await asyncio.gather(large, return_exceptions=True)
        await socket.finish(OFFLINE)

    async with operator(talk) as client:
        assert (await client.receive(timeout=WAIT_S)).data == data
        assert await closing(client) == (OFFLINE.code, OFFLINE.reason)


async def test_a_redirect_is_not_followed():
    visits = []

    async def elsewhere(request):
        visits.append(request)
        return web.Response()

    async with (
        serving(elsewhere) as target,
        ClientSession(trace_configs=[refuse_redirects()]) as client,
    ):

        async def redirect(_request):
            return web.Response(status=307, headers={"Location": target})

        async with serving(redirect) as robot:
            with pytest.raises(RedirectedError):
                await client.ws_connect(robot)
            with pytest.raises(RedirectedError):
                await client.get(robot)
        assert (await client.get(target)).status == 200
    assert len(visits) == 1
