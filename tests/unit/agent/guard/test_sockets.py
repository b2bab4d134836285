"""The WebSockets of the guard, before a rosbridge that does not read."""

from __future__ import annotations

import asyncio

import aiohttp
import pytest
from aiohttp import WSMsgType
from fake_rosbridge import FakeRosbridge
from robotether_agent.guard.sockets import (
    FAREWELL_S,
    SEND_BUFFER_BYTES,
    RosbridgeSocket,
    new_http,
    open_rosbridge,
)


async def test_text_stays_bytes() -> None:
    async with FakeRosbridge() as rosbridge, new_http() as http:
        socket = await open_rosbridge(http, f"ws://127.0.0.1:{rosbridge.port}/")
        await socket.send_frame(b'{"op":"publish","topic":"/echo"}', WSMsgType.TEXT)
        message = await socket.receive(timeout=5)
        assert (message.type, message.data) == (WSMsgType.TEXT, b'{"op":"publish","topic":"/echo"}')
        await socket.leave()
        assert socket.closed


async def test_a_rosbridge_that_does_not_read_is_seen_and_left_soon() -> None:
    """What waits is counted, and a goodbye that it does not take is cut short."""
    async with FakeRosbridge("slow_reader") as rosbridge, new_http() as http:
        socket = await open_rosbridge(http, f"ws://127.0.0.1:{rosbridge.port}/")
        await socket.send_frame(b"{}", WSMsgType.TEXT)
        frame = b"{}" + b" " * SEND_BUFFER_BYTES
        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(_send_on(socket, frame), 2)
        assert 0 < socket.waiting_bytes() < 8 * SEND_BUFFER_BYTES
        begun = asyncio.get_running_loop().time()
        await socket.leave()
        assert asyncio.get_running_loop().time() - begun < FAREWELL_S + 1
        socket.drop()
        socket.drop()


async def test_no_rosbridge_is_an_error() -> None:
    async with FakeRosbridge("refuses") as rosbridge, new_http() as http:
        with pytest.raises(aiohttp.WSServerHandshakeError):
            await open_rosbridge(http, f"ws://127.0.0.1:{rosbridge.port}/")


async def _send_on(socket: RosbridgeSocket, frame: bytes) -> None:
    while True:
        await socket.send_frame(frame, WSMsgType.TEXT)
