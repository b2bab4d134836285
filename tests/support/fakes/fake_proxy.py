"""An HTTP proxy for tests of CONNECT, with named ways to be of no use.

joins           as a proxy does
refuses         403 to everything
needs_password  407 unless the right name and password come along
silent          takes the request and says nothing
only_443        joins to port 443 only, which it leads to `behind_443`, as a server behind nginx has it
closes          ends the connection without an answer
"""

from __future__ import annotations

import asyncio
from base64 import b64encode
from contextlib import suppress
from typing import Literal, Self

from tcp_service import TcpService

Mode = Literal["joins", "refuses", "needs_password", "silent", "only_443", "closes"]

USER, PASSWORD = "robot", "s3cret/@:"
SECRET = b64encode(f"{USER}:{PASSWORD}".encode()).decode()


class FakeProxy(TcpService):
    """One proxy; `asked` are the authorities that it was asked for."""

    def __init__(self, mode: Mode = "joins", *, behind_443: int = 0) -> None:
        super().__init__()
        self.mode = mode
        self.asked: list[str] = []
        self._behind_443 = behind_443

    async def __aenter__(self) -> Self:
        await super().__aenter__()
        self.url = f"http://127.0.0.1:{self.port}"
        return self

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = (await reader.readuntil(b"\r\n\r\n")).decode()
        await self._answer(head, reader, writer)

    async def _answer(
        self, head: str, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        authority = head.split()[1]
        self.asked.append(authority)
        host, _, port = authority.rpartition(":")
        if self.mode == "silent":
            await reader.read()
        elif self.mode == "needs_password" and f"Proxy-Authorization: Basic {SECRET}" not in head:
            writer.write(b"HTTP/1.1 407 Proxy Authentication Required\r\n\r\n")
        elif self.mode == "refuses" or (self.mode == "only_443" and port != "443"):
            writer.write(b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\n\r\n")
        elif self.mode != "closes":
            to = self._behind_443 if self.mode == "only_443" else int(port)
            await self._join(host.strip("[]"), to, reader, writer)

    async def _join(
        self, host: str, port: int, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        try:
            far_reader, far_writer = await asyncio.open_connection(host, port)
        except OSError:
            writer.write(b"HTTP/1.1 503 Service Unavailable\r\n\r\n")
            return
        # With the server's first words in the same packet, as happens.
        early = await _early_words(far_reader) if self.mode == "joins" else b""
        writer.write(b"HTTP/1.1 200 Connection established\r\n\r\n" + early)
        try:
            await asyncio.gather(_pass(reader, far_writer), _pass(far_reader, writer))
        finally:
            far_writer.close()


async def _early_words(reader: asyncio.StreamReader) -> bytes:
    with suppress(asyncio.TimeoutError):
        return await asyncio.wait_for(reader.read(64), 0.1)
    return b""


async def _pass(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while data := await reader.read(65536):
        writer.write(data)
        await writer.drain()
    if writer.can_write_eof():
        writer.write_eof()
