"""The smallest WebSocket client that one round trip needs (RFC 6455): text out, text in, pings answered.

Used by robotether_round_trip. It is no client for anything else: no compression, no fragments of its own.
"""

from __future__ import annotations

import base64
import contextlib
import os
import socket
import struct
import time

TEXT, CLOSE, PING, PONG = 0x1, 0x8, 0x9, 0xA
FINAL = 0x80
HEADER_LIMIT = 64 * 1024
MESSAGE_LIMIT = 1024 * 1024
SHORT, LONG = 126, 127


class WebSocketError(Exception):
    """The WebSocket did not open, was closed, or broke; the text says how."""


class WebSocket:
    """A client's end of one WebSocket over a connected socket, which it closes at the end."""

    def __init__(self, sock: socket.socket, host: str, path: str) -> None:
        self._sock = sock
        self._buffer = b""
        key = base64.b64encode(os.urandom(16)).decode()
        sock.sendall(
            f"GET {path} HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        self._read_upgrade()

    def send(self, text: str) -> None:
        """Send one text message."""
        self._send(TEXT, text.encode())

    def receive(self, seconds: float) -> str:
        """Return the next text message; WebSocketError when it does not come in time."""
        end = time.monotonic() + seconds
        message = b""
        while True:
            self._sock.settimeout(max(0.01, end - time.monotonic()))
            first, payload = self._frame()
            kind = first & 0x0F
            if kind == CLOSE:
                raise WebSocketError(_reason(payload))
            if kind == PING:
                self._send(PONG, payload)
            elif kind != PONG:
                message += payload
                if first & FINAL:
                    return message.decode(errors="replace")

    def close(self) -> None:
        """Say goodbye and close the socket."""
        with contextlib.suppress(OSError):
            self._send(CLOSE, struct.pack(">H", 1000))
        self._sock.close()

    def _read_upgrade(self) -> None:
        while b"\r\n\r\n" not in self._buffer:
            if len(self._buffer) > HEADER_LIMIT:
                raise WebSocketError("the server's answer has no end")
            self._buffer += self._received()
        head, self._buffer = self._buffer.split(b"\r\n\r\n", 1)
        status = head.split(b"\r\n", 1)[0].decode(errors="replace")
        if " 101 " not in f"{status} ":
            raise WebSocketError(f"the server answers {status!r} in place of a WebSocket")

    def _send(self, kind: int, payload: bytes) -> None:
        mask = os.urandom(4)
        masked = bytes(byte ^ mask[at % 4] for at, byte in enumerate(payload))
        size = len(payload)
        length = bytes([0x80 | size]) if size < SHORT else struct.pack(">BH", 0x80 | SHORT, size)
        self._sock.sendall(bytes([FINAL | kind]) + length + mask + masked)

    def _frame(self) -> tuple[int, bytes]:
        first, size = self._exactly(2)
        size &= 0x7F
        if size == SHORT:
            (size,) = struct.unpack(">H", self._exactly(2))
        elif size == LONG:
            (size,) = struct.unpack(">Q", self._exactly(8))
        if size > MESSAGE_LIMIT:
            raise WebSocketError(f"a message of {size} bytes came")
        return first, self._exactly(size)

    def _exactly(self, size: int) -> bytes:
        while len(self._buffer) < size:
            self._buffer += self._received()
        taken, self._buffer = self._buffer[:size], self._buffer[size:]
        return taken

    def _received(self) -> bytes:
        try:
            data = self._sock.recv(64 * 1024)
        except TimeoutError as error:
            raise WebSocketError("no answer came in time") from error
        except OSError as error:
            raise WebSocketError(str(error)) from error
        if not data:
            raise WebSocketError("the connection was closed")
        return data


def _reason(payload: bytes) -> str:
    if len(payload) < struct.calcsize(">H"):
        return "the server closed the WebSocket"
    (code,) = struct.unpack(">H", payload[:2])
    return f"{payload[2:].decode(errors='replace')} [{code}]"
