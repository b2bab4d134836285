"""One operator's connection through the guard."""

from __future__ import annotations

import asyncio
from contextlib import suppress

import pytest
from aiohttp import WSMsgType
from guard_process import GuardClient, GuardHere
from sim_client import until


async def test_answers_are_few(guard: GuardHere) -> None:
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


async def test_pings_go_all_the_way(guard: GuardHere) -> None:
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
    assert [operation["op"] for _, operation in rosbridge.got] == []


async def test_a_client_that_reads_nothing_stops_the_reading_of_its_robot(guard, rosbridge):
    """No more than the buffers between them is held, and others are not held up."""
    async with GuardClient(guard.port, 0) as client, GuardClient(guard.port, 0) as other:
        await until("they are joined", lambda: len(rosbridge.sockets) == 3)
        transport = client.socket._response.connection
        assert transport is not None
        assert transport.transport is not None
        transport.transport.pause_reading()  # type: ignore[attr-defined]
        sent = 0
        with suppress(asyncio.TimeoutError):
            while sent < 256:
                await asyncio.wait_for(rosbridge.sockets[1].send_bytes(b"x" * 1024 * 1024), 1)
                sent += 1
        assert sent < 64
        await other.send(op="publish", topic="/echo")
        assert (await other.receive())["topic"] == "/echo"
