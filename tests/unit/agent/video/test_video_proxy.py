"""The proxy in front of web_video_server: bytes pass unchanged, as fast as the media connection takes them."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Literal

import pytest
from fake_cloud import eventually
from local_network import free_port
from noted_pacer import NotedPacer
from robotether_agent.video import video_proxy as proxy_module
from robotether_agent.video.bandwidth_estimator import Reading
from robotether_agent.video.pacer import Pacer
from robotether_agent.video.video_proxy import BULK_AFTER_BYTES, LocalService, VideoProxy
from tcp_service import TcpService

Handler = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]
WITHIN_S = 5


class Camera(TcpService):
    def __init__(self) -> None:
        super().__init__()
        self.handler: Handler = self._echo
        self.open = 0

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.open += 1
        try:
            await self.handler(reader, writer)
        finally:
            self.open -= 1

    async def _echo(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(65536):
            writer.write(data)
            await writer.drain()


@pytest.fixture
async def camera() -> AsyncIterator[Camera]:
    async with Camera() as made:
        yield made
        await eventually(lambda: made.open == 0, lambda: f"{made.open} streams are open")


@pytest.fixture
async def proxy(camera: Camera) -> AsyncIterator[VideoProxy]:
    made = VideoProxy(f"http://localhost:{camera.port}")
    yield made
    await made.close()


class LocalMedia(TcpService):
    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"own:" + await reader.readuntil(b"\r\n\r\n"))
        await writer.drain()


@asynccontextmanager
async def beside(
    port: int, when: Literal["never", "down", "always"] = "never"
) -> AsyncIterator[int]:
    async with LocalMedia() as local:
        proxy = VideoProxy(f"http://127.0.0.1:{port}", LocalService(local.port, when))
        yield await proxy.start()
        await proxy.close()


class LargeTopic(TcpService):
    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(bytes(100_000))
        await writer.drain()


async def test_a_large_message_of_a_topic_is_bulk_from_its_beginning() -> None:
    """Else many large topics, each of which gets little through a full line, take it from the video."""
    pacer = NotedPacer()
    async with LargeTopic() as local:
        proxy = VideoProxy("http://127.0.0.1:1", LocalService(local.port), pacer=pacer)
        request = b"GET /robotether/topics HTTP/1.1\r\nHost: x\r\n\r\n"
        assert len(await asked(await proxy.start(), request)) == 100_000
        await proxy.close()
    assert sum(size for size, is_bulk in pacer.turns if not is_bulk) <= BULK_AFTER_BYTES


async def asked(port: int, *pieces: bytes) -> bytes:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    for piece in pieces:
        writer.write(piece)
        await writer.drain()
        # A segment of its own each: the video proxy is to see halves.
        await asyncio.sleep(0.02)
    try:
        writer.write_eof()
        return await asyncio.wait_for(reader.read(-1), WITHIN_S)
    except ConnectionError:
        # Ended without an answer, and before all was read.
        return b""
    finally:
        writer.close()


OWN_REQUEST = b"GET /robotether/frames?topic=/camera HTTP/1.1\r\nHost: x\r\n\r\n"


@pytest.mark.parametrize("pieces", [1, len(OWN_REQUEST)])
async def test_the_agents_own_urls_lead_to_the_agent(camera: Camera, pieces: int) -> None:
    length = len(OWN_REQUEST) // pieces
    parts = [OWN_REQUEST[at : at + length] for at in range(0, len(OWN_REQUEST), length)]
    async with beside(camera.port) as port:
        assert await asked(port, *parts) == b"own:" + OWN_REQUEST


@pytest.mark.parametrize(
    "request_bytes",
    [
        b"GET /stream?topic=/camera HTTP/1.1\r\n\r\n",
        b"GET /robotethe",
        b"GET /robotetherX/ HTTP/1.1\r\n\r\n",
        b"POST /robotether/frames HTTP/1.1\r\n\r\n",
        b"get /robotether/frames HTTP/1.1\r\n\r\n",
        b"\x16\x03\x01",
        b"",
    ],
)
async def test_all_else_passes_unchanged(camera: Camera, request_bytes: bytes) -> None:
    async with beside(camera.port, "down") as port:
        assert await asked(port, request_bytes[:7], request_bytes[7:]) == request_bytes


async def test_a_request_that_stops_halfway_is_not_held_for_long(camera, monkeypatch):
    monkeypatch.setattr(proxy_module, "FIRST_WORDS_S", 0.2)
    async with beside(camera.port) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET /robo")
        assert await asyncio.wait_for(reader.readexactly(9), WITHIN_S) == b"GET /robo"
        writer.write(b"tether/frames")
        assert await asyncio.wait_for(reader.readexactly(13), WITHIN_S) == b"tether/frames"
        writer.close()


@pytest.mark.parametrize(
    ("when", "runs", "answers"),
    [
        ("never", True, b""),
        ("never", False, None),
        ("down", True, b""),
        ("down", False, b"own:"),
        ("always", True, b"own:"),
    ],
)
async def test_who_answers_in_web_video_servers_place(camera, when, runs, answers):
    """As the settings say: nobody, the agent while nothing answers there, or always the agent."""
    request = b"GET /stream?topic=/camera HTTP/1.1\r\n\r\n"
    expected = b"" if answers is None else answers + request
    async with beside(camera.port if runs else free_port(), when) as port:
        assert await asked(port, request) == expected


async def test_a_viewer_that_leaves_ends_the_stream(proxy: VideoProxy, camera: Camera) -> None:
    async def stream(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            writer.write(bytes(10_000))
            await writer.drain()

    camera.handler = stream
    reader, writer = await asyncio.open_connection("127.0.0.1", await proxy.start())
    await reader.readexactly(50_000)
    writer.transport.abort()
    await eventually(lambda: camera.open == 0, lambda: "the stream has ended")


async def test_a_viewer_of_nothing_is_let_go(proxy, camera, monkeypatch):
    """One who asks no more and gets nothing any more; a camera without frames would never notice."""
    monkeypatch.setattr(proxy_module, "LAST_S", 0.1)
    forever = asyncio.Event()

    async def silent(*_: object) -> None:
        await forever.wait()

    camera.handler = silent
    reader, writer = await asyncio.open_connection("127.0.0.1", await proxy.start())
    writer.write_eof()
    assert await asyncio.wait_for(reader.read(-1), WITHIN_S) == b""
    writer.close()
    forever.set()


async def test_streams_have_a_number(proxy, camera, monkeypatch):
    monkeypatch.setattr(proxy_module, "MAX_STREAMS", 1)
    port = await proxy.start()
    first = await asyncio.open_connection("127.0.0.1", port)
    first[1].write(b"x")
    assert await first[0].readexactly(1) == b"x"
    second = await asyncio.open_connection("127.0.0.1", port)
    assert await asyncio.wait_for(second[0].read(-1), WITHIN_S) == b""
    first[1].write(b"y")
    assert await first[0].readexactly(1) == b"y"
    for _, writer in (first, second):
        writer.close()


async def test_the_camera_waits_while_the_window_is_full(camera: Camera) -> None:
    written = 0

    async def stream(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal written
        writer.transport.set_write_buffer_limits(high=0)
        while True:
            writer.write(bytes(10_000))
            written += 10_000
            await writer.drain()

    camera.handler = stream
    # 14,480 bytes may go; nothing ever arrives.
    started = time.monotonic()

    def stalled(_: socket.socket, now_s: float) -> Reading:
        handed = 14_480 if now_s > started else 0
        return Reading(now_s, handed, 0, 0.04, 0.04, 1448)

    proxy = VideoProxy(f"http://127.0.0.1:{camera.port}", pacer=Pacer(stalled))
    with socket.socket() as handle:
        proxy.use(handle)
        _, writer = await asyncio.open_connection("127.0.0.1", await proxy.start())
        last = -1
        while written != last:
            last = written
            await asyncio.sleep(0.1)
        assert 0 < written < 300_000
        writer.close()
        await proxy.close()
