"""A double of web_video_server.

Its modes: `streams`; `silent` sends headers and no picture; `ends` ends each stream at once; `refuses`
answers 500; `lists` is another type than multipart. Its pictures are a JPEG's headers, with as many bytes as their
quality would have.
"""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import Callable
from typing import Any, Literal

from aiohttp import web
from tcp_service import WebService

Mode = Literal["streams", "silent", "ends", "refuses", "lists"]
BYTES_A_QUALITY = 400


def fake_jpeg(number: int, *, size: tuple[int, int] = (640, 480), length: int = 2000) -> bytes:
    """What begins like a JPEG of that size: a comment with its number, the start of frame, and filling."""
    comment = b"\xff\xfe" + struct.pack("!HI", 6, number)
    frame = b"\xff\xc0" + struct.pack("!HBHHB", 8, 8, size[1], size[0], 0)
    return (b"\xff\xd8" + comment + frame).ljust(length - 2, b"\x00") + b"\xff\xd9"


def number_of(jpeg: bytes) -> int:
    number: int = struct.unpack_from("!I", jpeg, 6)[0]
    return number


class FakeVideoServer(WebService):
    handler_cancellation = True

    def __init__(self, mode: Mode = "streams", fps: float = 30.0) -> None:
        super().__init__()
        self.mode = mode
        self.fps = fps
        self.size = (640, 480)
        # The pictures that were made, for all streams together: the same moment has the same number in each.
        self.number = 0
        self.stamp: Callable[[], float] | None = time.time
        self.names_length = True
        self.content_type = "image/jpeg"
        # Sent in place of a JPEG.
        self.picture: bytes | None = None
        # Where it leads whoever asks for a stream; empty: nowhere.
        self.redirects_to = ""
        self.asked: list[dict[str, str]] = []
        self.open = 0
        self.open_most = 0

    async def start(self) -> None:
        await super().start()
        self._clock = asyncio.ensure_future(self._count())

    async def stop(self) -> None:
        self._clock.cancel()
        await asyncio.gather(self._clock, return_exceptions=True)
        await super().stop()

    def _routes(self) -> dict[str, Any]:
        return {"/": self._list, "/stream": self._stream}

    async def _count(self) -> None:
        self._made = asyncio.Condition()
        while True:
            async with self._made:
                self.number += 1
                self._made.notify_all()
            await asyncio.sleep(1 / self.fps)

    async def _list(self, _: web.Request) -> web.Response:
        return web.Response(text="topics", status=500 if self.mode == "refuses" else 200)

    async def _stream(self, request: web.Request) -> web.StreamResponse:
        self.asked.append(dict(request.query))
        if self.redirects_to:
            raise web.HTTPFound(self.redirects_to)
        if self.mode == "refuses":
            return web.Response(status=500)
        kind = "text/html" if self.mode == "lists" else "multipart/x-mixed-replace;boundary=--b"
        answer = web.StreamResponse(headers={"Content-Type": kind})
        answer.force_close()
        await answer.prepare(request)
        self.open += 1
        self.open_most = max(self.open_most, self.open)
        try:
            await answer.write(b"--b\r\n")
            if self.mode == "silent":
                await asyncio.Event().wait()
            if self.mode == "streams":
                await self._send(answer, request.query)
        except ConnectionError:
            pass
        finally:
            self.open -= 1
        return answer

    async def _send(self, answer: web.StreamResponse, query: Any) -> None:
        length = BYTES_A_QUALITY * int(query.get("quality", 95))
        size = self.size
        if "width" in query:
            size = int(query["width"]), int(query["height"])
            length = length * size[0] * size[1] // (self.size[0] * self.size[1])
        while self.mode == "streams":
            async with self._made:
                await self._made.wait()
            head = f"Content-type: {self.content_type}\r\n"
            if self.stamp is not None:
                head += f"X-Timestamp: {self.stamp():.06f}\r\n"
            jpeg = self.picture or fake_jpeg(self.number, size=size, length=length)
            if self.names_length:
                head += f"Content-Length: {len(jpeg)}\r\n"
            await answer.write(head.encode() + b"\r\n" + jpeg + b"\r\n--b\r\n")
