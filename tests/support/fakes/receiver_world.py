"""A receiver of frames as the agent runs it, with a socket and a source that tests play."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from typing import Any, cast

from aiohttp import WSMsgType, web
from fake_cameras import fake_jpeg, number_of
from fake_cloud import eventually
from robotether_agent.video.frame_encoder import EncoderPool
from robotether_agent.video.frame_messages import Header
from robotether_agent.video.receiver import Receiver
from robotether_agent.video.shared_sources import SharedSources
from robotether_agent.video.sources import CameraFrame, OnFrame, SourceRequest
from robotether_common.codecs import CODECS, JPEG, Codec
from robotether_common.frames import HEADER, KEY, STAMPED, Source

SIZE = HEADER.size


def unpacked(message: bytes) -> Header:
    codec, flags, quality, sequence, timestamp_ms = HEADER.unpack_from(message)
    is_stamped, is_key = bool(flags & STAMPED), bool(flags & KEY)
    return Header(sequence, timestamp_ms, quality, is_stamped, CODECS[codec], is_key)


class FakeMessage:
    def __init__(self, data: str) -> None:
        self.type = WSMsgType.TEXT
        self.data = data


class FakeSocket:
    """What a receiver reads from and writes to; `stuck` is a link that takes nothing."""

    def __init__(self) -> None:
        self.texts: list[dict] = []
        self.pictures: list[bytes] = []
        self.stuck = False
        self._asked: deque[str] = deque()
        self._more = asyncio.Event()

    def ask(self, op: str, **fields: object) -> None:
        self._asked.append(json.dumps({"op": op, **fields}))
        self._more.set()

    def __aiter__(self):
        return self

    async def __anext__(self) -> FakeMessage:
        while not self._asked:
            self._more.clear()
            await self._more.wait()
        return FakeMessage(self._asked.popleft())

    async def send_str(self, text: str) -> None:
        self.texts.append(json.loads(text))

    async def send_bytes(self, data: bytes) -> None:
        self.pictures.append(data)
        if self.stuck:
            await asyncio.Event().wait()


# The numbers of a receiver begin at its clock in ms.
FIRST = 100_000


class World:
    def __init__(self, *, steps_quality: bool = True, encoders: EncoderPool | None = None) -> None:
        self.now_s = FIRST / 1000
        self.kind: Source = "web_video_server"
        self.sent: list[tuple[str, int, float]] = []
        self.socket = FakeSocket()
        self.open: dict[SourceRequest, OnFrame] = {}
        # Of the encoders, where a test collects them.
        self.reports: list[str] = []
        self.shared_sources = SharedSources(self._run, lambda: self.now_s)
        self.receiver = Receiver(
            cast(web.WebSocketResponse, self.socket),
            "/camera",
            self.shared_sources,
            steps_quality=lambda: steps_quality,
            encoders=encoders,
            on_frame_sent=lambda *frame: self.sent.append(frame),
            clock=lambda: self.now_s,
        )
        self.task = asyncio.ensure_future(self.receiver.run())

    async def _run(self, source_request, take, tell) -> None:
        tell(self.kind)
        self.open[source_request] = take
        try:
            await asyncio.Event().wait()
        finally:
            del self.open[source_request]

    async def end(self) -> None:
        self.task.cancel()
        await asyncio.gather(self.task, return_exceptions=True)
        await self.shared_sources.close()

    async def until_open(self) -> SourceRequest:
        await eventually(lambda: bool(self.open), lambda: "a source is open")
        return list(self.open)[-1]

    def give(self, number: int, after_s: float = 0.1) -> None:
        self.give_data(fake_jpeg(number), after_s)

    def give_data(
        self, data: bytes, after_s: float = 0.1, codec: Codec = JPEG, *, is_key: bool = False
    ) -> None:
        self.now_s += after_s
        for take in tuple(self.open.values()):
            take(CameraFrame(data, self.now_s, self.now_s, codec=codec, is_key=is_key))

    async def pass_on(self, data: bytes, after_s: float = 0.1, **frame: Any) -> bytes:
        count = len(self.socket.pictures) + 1
        self.socket.ask("credit")
        self.give_data(data, after_s, **frame)
        await self.got(count)
        return self.socket.pictures[-1]

    async def have_taken(self, after_s: float) -> None:
        """Have the receiver take the newest frame so much later, which asks for the next one."""
        self.now_s += after_s
        self.socket.ask("credit", taken=unpacked(self.socket.pictures[-1]).sequence)
        await eventually(lambda: not self.receiver._in_flight, lambda: "it was taken")

    async def got(self, count: int) -> list[int]:
        await eventually(lambda: len(self.socket.pictures) >= count, lambda: str(self.socket.texts))
        return [number_of(data[SIZE:]) for data in self.socket.pictures]
