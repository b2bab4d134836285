"""A session whose WebSockets keep the time limit of `receive`, which aiohttp's begin anew with each ping that comes."""

from __future__ import annotations

import asyncio
from typing import Any

import aiohttp


class TimedWebSocket(aiohttp.ClientWebSocketResponse):
    """Counts the time limit from the call, whatever pings and pongs come meanwhile."""

    async def receive(self, timeout: float | None = None) -> Any:
        """Wait for the next message that is no ping or pong; TimeoutError after `timeout` seconds."""
        async with asyncio.timeout(timeout):
            return await super().receive()


def timed_session(**options: Any) -> aiohttp.ClientSession:
    return aiohttp.ClientSession(ws_response_class=TimedWebSocket, **options)
