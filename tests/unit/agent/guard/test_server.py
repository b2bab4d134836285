"""Whose connections the guard accepts."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import aiohttp
import pytest
from fake_rosbridge import FakeRosbridge
from guard_process import KEY, GuardClient
from robotether_agent.guard import server as server_module
from robotether_agent.guard.agent_messages import GuardConfig
from robotether_agent.guard.authorizer import Authorizer
from robotether_agent.guard.drive_controller import DriveController
from robotether_agent.guard.fences import FenceFile, FenceStore
from robotether_agent.guard.rosbridge import CmdVelPublisher
from robotether_agent.guard.server import Server
from robotether_agent.guard.topics import MotionFile
from robotether_agent.rosbridge_socket import new_http


@asynccontextmanager
async def running(
    port: int | None, place: Path, state_dir: Path | None = None
) -> AsyncIterator[tuple[int, Authorizer, Server]]:
    """A server before a rosbridge, or before its configuration."""
    config = None if port is None else GuardConfig(f"ws://127.0.0.1:{port}/", KEY)
    authorizer = Authorizer(time.monotonic())
    authorizer.key = KEY
    authorizer.session(up=True)
    authorizer.lease(13, held=True)
    async with new_http() as http:
        publisher = CmdVelPublisher(http, time.monotonic)
        controller = DriveController(
            publisher, authorizer, MotionFile(place), time.monotonic, lambda: None
        )
        fences = FenceStore(FenceFile(state_dir or place))
        server = Server(
            http,
            authorizer,
            controller,
            lambda: config,
            lambda: port is not None,
            keep_fence=fences.keep,
        )
        yield await server.start(), authorizer, server
        await server.stop()
        # As the guard's process ends: who observes has the number tried once more, and does not wait.
        await fences.settled()


async def refusal(
    port: int, fence: int | None = 0, key: str = KEY
) -> aiohttp.WSServerHandshakeError:
    """What a handshake is refused with."""
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        async with GuardClient(port, fence, key):
            pass
    return refused.value


async def status(port: int, fence: int | None = 0, key: str = KEY) -> int:
    """The status that a handshake is refused with."""
    return (await refusal(port, fence, key)).status


async def looked_up(port: int) -> int:
    """What a request without a WebSocket is answered."""
    async with aiohttp.ClientSession() as http, http.get(f"http://127.0.0.1:{port}/") as answer:
        return answer.status


async def test_a_newer_driver_ends_the_older_one(tmp_path: Path) -> None:
    """At the door, before any line of the lease came; observers stay."""
    async with AsyncExitStack() as stack:
        rosbridge = await stack.enter_async_context(FakeRosbridge())
        port, _, _ = await stack.enter_async_context(running(rosbridge.port, tmp_path))
        observer, old, new = [
            await stack.enter_async_context(GuardClient(port, fence)) for fence in (0, 13, 14)
        ]
        why = "its guard reports that the right to drive is over"
        assert await old.close_reason() == (1001, why)
        await new.send(op="publish", topic="/echo")
        assert (await new.receive())["topic"] == "/echo"
        assert not observer.socket.closed


async def test_a_disk_that_cannot_be_written_lets_nobody_drive(tmp_path: Path) -> None:
    """After a restart the guard would not know the number; who observes comes in."""
    async with (
        FakeRosbridge() as rosbridge,
        running(rosbridge.port, tmp_path, tmp_path / "gone") as (port, _, _),
    ):
        assert await status(port, 13) == 507
        async with GuardClient(port, 0):
            assert rosbridge.connections == 1


async def test_without_rosbridge_or_settings_it_is_502(tmp_path: Path) -> None:
    """A request without a WebSocket is told so, too."""
    async with running(None, tmp_path) as (port, _, _):
        assert await status(port, 0) == await looked_up(port) == 502
    async with (
        FakeRosbridge("refuses") as rosbridge,
        running(rosbridge.port, tmp_path) as (port, _, _),
    ):
        assert await status(port, 13) == 502


async def test_the_relay_reads_why_it_is_refused(tmp_path: Path) -> None:
    """A close reason has room for some 80 characters of it."""
    async with (
        FakeRosbridge("refuses") as rosbridge,
        running(rosbridge.port, tmp_path) as (port, authorizer, _),
    ):
        reasons = [(await refusal(port, 13)).headers["Robotether-Reason"]]
        authorizer.stop()
        reasons.append((await refusal(port, 13)).headers["Robotether-Reason"])
    unreached = "it answers with HTTP status 503, not with a WebSocket"
    assert reasons == [unreached, "the robot is stopped"]


async def direct_door(stack: AsyncExitStack, place: Path) -> int:
    """The port of a server that takes direct connections too."""
    rosbridge = await stack.enter_async_context(FakeRosbridge())
    port, rights, _ = await stack.enter_async_context(running(rosbridge.port, place))
    rights.direct = True
    return port


async def enters(stack: AsyncExitStack, port: int) -> bool:
    """Whether there is a place for a direct connection, which then has it."""
    try:
        await stack.enter_async_context(GuardClient(port, None))
    except aiohttp.WSServerHandshakeError:
        return False
    return True


async def test_a_look_up_needs_no_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The server asks whether rosbridge is there, however many connections are open."""
    monkeypatch.setattr(server_module, "MAX_CONNECTIONS", 0)
    async with FakeRosbridge() as rosbridge, running(rosbridge.port, tmp_path) as (port, _, _):
        assert await status(port) == 503
        assert await looked_up(port) == 426


async def test_who_does_not_drive_leaves_a_driver_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A driver may have 32 connections with calls over HTTP, beside the 64 of observers and those of programs here."""
    others = server_module.MAX_OTHER_CONNECTIONS
    assert others - server_module.MAX_DIRECT_CONNECTIONS >= 64
    assert server_module.MAX_CONNECTIONS - others >= 32
    monkeypatch.setattr(server_module, "MAX_OTHER_CONNECTIONS", 1)
    async with (
        FakeRosbridge() as rosbridge,
        running(rosbridge.port, tmp_path) as (port, _, _),
        GuardClient(port, 13),
        GuardClient(port, 0),
    ):
        assert await status(port, 0) == 503
        async with GuardClient(port, 13) as driver:
            assert not driver.socket.closed


async def test_a_direct_connection_that_ends_frees_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another direct one gets it; the server's connections never take it."""
    monkeypatch.setattr(server_module, "MAX_DIRECT_CONNECTIONS", 1)
    async with AsyncExitStack() as stack:
        port = await direct_door(stack, tmp_path)
        await stack.enter_async_context(GuardClient(port, 0))
        async with GuardClient(port, None):
            assert await status(port, None) == 503
        for _ in range(500):
            if await enters(stack, port):
                return
            await asyncio.sleep(0.01)
        pytest.fail("its place is not free in 5 s")
