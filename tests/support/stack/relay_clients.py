"""What the relay's tests do with an operator's or a robot's connection, beside opening it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import aiohttp
import pytest
from aiohttp import WSMsgType
from fake_robot import WAIT_S, RobotSession
from relay_server import MemoryDatabase
from robotether_server.db.control import NewLease
from robotether_server.db.fleet import AuditEntry

# As the relay writes it anew.
PUBLISH = '{"op":"publish","topic":"/cmd_vel","msg":{"linear":{"x":0.5}}}'


async def closing(socket: aiohttp.ClientWebSocketResponse) -> tuple[int | None, str]:
    # Not receive(timeout=...), which begins anew with each ping that it answers.
    async with asyncio.timeout(WAIT_S):
        while (message := await socket.receive()).type is not WSMsgType.CLOSE:
            assert message.type not in {WSMsgType.CLOSED, WSMsgType.ERROR}, "closed without a code"
    return message.data, message.extra or ""


async def refusal(
    http: aiohttp.ClientSession, url: str, headers: dict[str, str] | None = None
) -> int:
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        await http.ws_connect(url, headers=headers)
    return refused.value.status


async def ended(session: RobotSession) -> str | None:
    """Wait for the end of a robot's session; return the code of the bye, None without one."""
    await asyncio.wait_for(session.closed.wait(), WAIT_S)
    return session.bye["code"] if session.bye else None


async def configured(session: RobotSession) -> RobotSession:
    await session.wait_configured()
    return session


def audit_lines(memory_database: MemoryDatabase) -> list[AuditEntry]:
    return [entry for entry in memory_database.written if isinstance(entry, AuditEntry)]


class SlowFences:
    def __init__(self, memory_database: MemoryDatabase) -> None:
        self.asked, self.go_on = asyncio.Event(), asyncio.Event()
        self._next_fence = memory_database.next_fence

    async def next_fence(self, lease: NewLease) -> int:
        self.asked.set()
        await self.go_on.wait()
        return await self._next_fence(lease)


@asynccontextmanager
async def counted_turns() -> AsyncIterator[Callable[[], int]]:
    """Count the turns that others get in the block, where the loop is not held up."""
    turns = 0

    async def count() -> None:
        nonlocal turns
        while True:
            await asyncio.sleep(0)
            turns += 1

    counting = asyncio.create_task(count())
    yield lambda: turns
    counting.cancel()
