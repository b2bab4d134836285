"""Who watches a camera over the frames protocol (docs/reference/media.md), as a page or program does."""

from __future__ import annotations

import asyncio
import json
import struct
from collections import deque
from dataclasses import dataclass
from typing import Any

import aiohttp
from aiohttp import WSMsgType

HEADER = struct.Struct("!BBHId")
WAIT_S = 30.0


@dataclass(frozen=True)
class Seen:
    codec: int
    flags: int
    quality: int
    sequence: int
    timestamp_ms: float
    jpeg: bytes


class FramesViewer:
    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket
        self.texts: deque[dict[str, Any]] = deque()
        self.taken: int | None = None

    async def ask(self, **members: object) -> None:
        await self.socket.send_json({"op": "stream_request", **members})

    async def credit(self, frames: int = 1, **members: object) -> None:
        await self.socket.send_json(
            {"op": "credit", "frames": frames, "taken": self.taken} | members
        )

    async def frame(self) -> Seen:
        async with asyncio.timeout(WAIT_S):
            while True:
                message = await self.socket.receive()
                if message.type is WSMsgType.BINARY:
                    codec, flags, quality, sequence, timestamp_ms = HEADER.unpack_from(message.data)
                    jpeg = message.data[HEADER.size :]
                    seen = Seen(codec, flags, quality, sequence, timestamp_ms, jpeg)
                    self.taken = seen.sequence
                    return seen
                assert message.type is WSMsgType.TEXT, message
                self.texts.append(json.loads(message.data))

    async def text(self, op: str, **members: object) -> dict[str, Any]:
        async with asyncio.timeout(WAIT_S):
            while True:
                while self.texts:
                    text = self.texts.popleft()
                    if text["op"] == op and members.items() <= text.items():
                        return text
                message = await self.socket.receive()
                assert message.type is WSMsgType.TEXT, message
                self.texts.append(json.loads(message.data))
