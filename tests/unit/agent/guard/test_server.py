"""Whose connections the guard accepts, and what passes through one."""

import asyncio
from contextlib import AsyncExitStack, suppress
from unittest.mock import AsyncMock, Mock

import aiohttp
import pytest
from aiohttp import WSMsgType
from fake_rosbridge import FakeRosbridge
from guard_process import GuardClient, GuardHere
from robotether_agent.guard import server as server_module
from robotether_agent.guard.topics import Authorization
from sim_client import until


async def refusal(port, fence=0):
    """What a handshake is refused with."""
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        async with GuardClient(port, fence):
            pass
    return refused.value


async def test_a_newer_driver_ends_the_older_one(guard):
    """It does so at the handshake, before any line of the lease came; observers stay."""
    async with AsyncExitStack() as stack:
        observer, old, new = [
            await stack.enter_async_context(GuardClient(guard.port, fence)) for fence in (0, 13, 14)
        ]
        why = "its guard reports that the right to drive is over"
        assert await old.close_reason() == (1001, why)
        await new.send(op="publish", topic="/echo")
        assert (await new.receive())["topic"] == "/echo"
        assert not observer.socket.closed


async def test_a_disk_that_cannot_be_written_lets_nobody_drive(guard, place):
    """After a restart the guard would not know the number; who observes comes in."""
    file = place / "fence.json"
    await until("the first number is written", file.exists)
    file.unlink()
    file.mkdir()
    assert (await refusal(guard.port, 14)).status == 507
    async with GuardClient(guard.port, 0) as observer:
        assert not observer.socket.closed


async def test_the_relay_reads_why_it_is_refused(place):
    """A close reason has room for some 80 characters of it."""
    async with (
        FakeRosbridge(mode="refuses") as rosbridge,
        GuardHere(place, rosbridge.port) as guard,
    ):
        await guard.grant(13)
        refused = [await refusal(guard.port, 13)]
        guard.tell(type="stop", id="5f", by="ben")
        await guard.until(lambda: guard.state["stopped"], "it is stopped")
        refused.append(await refusal(guard.port, 13))
    assert [(each.status, each.headers["Robotether-Reason"]) for each in refused] == [
        (502, "it answers with HTTP status 503, not with a WebSocket"),
        (409, "the robot is stopped"),
    ]


async def test_a_look_up_needs_no_place(guard, monkeypatch):
    """The server asks whether rosbridge is there, however many connections are open."""
    monkeypatch.setattr(server_module, "MAX_CONNECTIONS", 0)
    assert (await refusal(guard.port)).status == 503
    answers = []
    async with asyncio.timeout(5), aiohttp.ClientSession() as http:
        # 502 until the guard is connected to rosbridge.
        while answers[-1:] != [426]:
            async with http.get(f"http://127.0.0.1:{guard.port}/") as answer:
                answers.append(answer.status)
    assert set(answers) <= {502, 426}


async def test_who_does_not_drive_leaves_a_driver_room(guard, monkeypatch):
    """A driver may have 32 connections with calls over HTTP, beside the 64 of observers and those of programs here."""
    others = server_module.MAX_OTHER_CONNECTIONS
    assert others - server_module.MAX_DIRECT_CONNECTIONS >= 64
    assert server_module.MAX_CONNECTIONS - others >= 32
    monkeypatch.setattr(server_module, "MAX_OTHER_CONNECTIONS", 1)
    async with GuardClient(guard.port, 13), GuardClient(guard.port, 0):
        assert (await refusal(guard.port, 0)).status == 503
        async with GuardClient(guard.port, 13) as driver:
            assert not driver.socket.closed


async def enters(port):
    try:
        async with GuardClient(port, None):
            return True
    except aiohttp.WSServerHandshakeError:
        return False


async def test_a_direct_connection_that_ends_frees_its_place(guard, monkeypatch):
    """Another direct one gets it; the server's connections never take it."""
    monkeypatch.setattr(server_module, "MAX_DIRECT_CONNECTIONS", 1)
    guard.reconfigure(direct=True)
    await guard.heard()
    async with GuardClient(guard.port, 0):
        async with GuardClient(guard.port, None):
            assert (await refusal(guard.port, None)).status == 503
        for _ in range(500):
            if await enters(guard.port):
                return
            await asyncio.sleep(0.01)
        pytest.fail("its place is not free in 5 s")


async def test_answers_are_few(guard):
    """One a second of each kind, however many were refused; the first names its message."""
    async with GuardClient(guard.port, 0) as client:
        await client.send(op="png", id="p1")
        for _ in range(50):
            await client.socket.send_str("rubbish")
        await client.send(op="publish", topic="/echo")
        answers = [await client.receive() for _ in range(2)]
        assert [(each["op"], each.get("id")) for each in answers] == [
            ("status", "p1"),
            ("publish", None),
        ]


async def test_client_that_reads_nothing_gets_no_more_answers():
    client = Mock(closed=False, send_frame=AsyncMock())
    proxy = server_module.ClientProxy(Authorization("observe"), client, Mock(), Mock())
    for waiting, answers in ((server_module.ANSWERS_WAITING_BYTES + 1, 0), (0, 1)):
        client.waiting_bytes.return_value = waiting
        proxy.notify(b"{}")
        await asyncio.sleep(0)
        assert client.send_frame.call_count == answers


async def test_pings_go_all_the_way(guard):
    """So that a client sees whether rosbridge lives, and not whether the guard does."""
    async with GuardClient(guard.port, 0) as client:
        client.socket._autoping = False
        await client.socket.ping(b"are you there")
        message = await client.socket.receive(timeout=5)
        assert (message.type, message.data) == (WSMsgType.PONG, b"are you there")


async def test_a_client_that_ends_ends_its_connection_to_rosbridge(guard, rosbridge):
    async with GuardClient(guard.port, 0) as client:
        await until("it is joined", lambda: len(rosbridge.sockets) == 2)
        await client.socket.close()
        await until("rosbridge sees it", lambda: rosbridge.sockets[1].closed)


@pytest.mark.parametrize(
    ("message", "reason"), [(b"", "rosbridge closed the connection"), (b"too slow", "too slow")]
)
async def test_why_rosbridge_closes_is_passed_on(guard, rosbridge, message, reason):
    async with GuardClient(guard.port, 0) as client:
        await until("it is joined", lambda: len(rosbridge.sockets) == 2)
        closing = asyncio.create_task(rosbridge.sockets[1].close(code=4321, message=message))
        assert await client.close_reason() == (4321, reason)
        await closing


async def test_nothing_passes_once_the_lease_is_over(guard, rosbridge):
    """Neither what came with the end, nor what waits in the socket: a call could move the robot after a stop."""
    async with GuardClient(guard.port, 13) as client:
        await until("it is joined", lambda: len(rosbridge.sockets) == 2)
        for _ in range(20):
            await client.send(op="call_service", service="/dock")
        guard.tell(type="stop", id="5f", by="ben")
        await client.closed()
    assert [operation["op"] for operation in rosbridge.got] == []


async def test_a_client_that_reads_nothing_stops_the_reading_of_its_robot(guard, rosbridge):
    """No more than the buffers between them is held, and others are not held up."""
    async with GuardClient(guard.port, 0) as client, GuardClient(guard.port, 0) as other:
        await until("they are joined", lambda: len(rosbridge.sockets) == 3)
        transport = client.socket._response.connection
        transport.transport.pause_reading()
        sent = 0
        with suppress(asyncio.TimeoutError):
            while sent < 256:
                await asyncio.wait_for(rosbridge.sockets[1].send_bytes(b"x" * 1024 * 1024), 1)
                sent += 1
        assert sent < 64
        await other.send(op="publish", topic="/echo")
        assert (await other.receive())["topic"] == "/echo"
