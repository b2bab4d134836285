"""Takes the parts out of a stream of multipart/x-mixed-replace, as cameras and web_video_server send it. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from email.message import Message

from robotether_common.frames import MAX_FRAME_BYTES

from robotether_agent.problems import DetailError

MAX_HEAD_BYTES = 8 * 1024
BLANK = b"\r\n"


class MultipartBrokenError(DetailError, ValueError):
    """What came is no such stream."""


@dataclass(frozen=True)
class Part:
    """One part: its headers, with names in lower case, and its body."""

    headers: Mapping[str, str]
    body: bytes


def boundary_of(content_type: str) -> bytes:
    """Return the bytes between parts; MultipartBrokenError for another type than multipart."""
    message = Message()
    message["Content-Type"] = content_type
    boundary = message.get_param("boundary")
    if message.get_content_maintype() != "multipart" or not isinstance(boundary, str):
        raise MultipartBrokenError(f"it sends {content_type or 'no type'}, not multipart frames")
    return b"--" + boundary.strip().strip('"').lstrip("-").encode("latin-1", "replace")


class MultipartParser:
    """The parts of one stream of multipart/x-mixed-replace, from the bytes as they come; never holds more than one.

    Cameras differ: some name no length, some have the dashes of the boundary in its name already, some end lines in LF.
    """

    def __init__(self, boundary: bytes) -> None:
        self._boundary = boundary
        self._buffer = bytearray()
        self._headers: Mapping[str, str] | None = None
        # Where the search for the next boundary goes on.
        self._searched = 0

    def feed(self, data: bytes) -> Iterator[Part]:
        """Yield the parts that `data` completes."""
        self._buffer += data
        while True:
            if self._headers is None:
                self._headers = self._head()
            if self._headers is None:
                return
            body = self._body(self._headers)
            if body is None:
                return
            part = Part(self._headers, body)
            self._headers, self._searched = None, 0
            yield part

    def _head(self) -> Mapping[str, str] | None:
        start = len(self._buffer) - len(self._buffer.lstrip(BLANK))
        ends = [
            (at, len(mark))
            for mark in (b"\r\n\r\n", b"\n\n")
            if (at := self._buffer.find(mark, start)) >= 0
        ]
        if not ends:
            if len(self._buffer) > MAX_HEAD_BYTES:
                raise MultipartBrokenError("a part's headers do not end")
            return None
        at, length = min(ends)
        lines = self._buffer[start:at].decode("latin-1").splitlines()
        del self._buffer[: at + length]
        fields = (line.partition(":") for line in lines if ":" in line)
        return {name.strip().lower(): value.strip() for name, _, value in fields}

    def _body(self, headers: Mapping[str, str]) -> bytes | None:
        length = headers.get("content-length", "")
        if length.isascii() and length.isdecimal():
            return self._sized(int(length[:12]))
        at = self._buffer.find(self._boundary, self._searched)
        if at < 0:
            self._check(len(self._buffer))
            self._searched = max(0, len(self._buffer) - len(self._boundary))
            return None
        body = bytes(self._buffer[:at])
        del self._buffer[:at]
        return body.removesuffix(b"\n").removesuffix(b"\r")

    def _sized(self, length: int) -> bytes | None:
        self._check(length)
        if len(self._buffer) < length:
            return None
        body = bytes(self._buffer[:length])
        del self._buffer[:length]
        return body

    def _check(self, length: int) -> None:
        if length > MAX_FRAME_BYTES:
            raise MultipartBrokenError(f"it sends a frame of over {MAX_FRAME_BYTES} bytes")
