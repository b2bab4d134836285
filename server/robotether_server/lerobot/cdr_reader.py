"""Reads a message in CDR, field by field, as `recorder/cdr.py` writes it. Pure."""

from __future__ import annotations

import struct
from collections.abc import Mapping

from robotether_server.contract.recordings import CDR_START
from robotether_server.problems import RobotetherError

NUMBERS: Mapping[str, struct.Struct] = {letter: struct.Struct(f"<{letter}") for letter in "?iIqfd"}


class DecodingError(RobotetherError):
    """A message is not of its type."""


class CdrReader:
    """The fields of one message in their order; each method raises DecodingError."""

    def __init__(self, data: bytes) -> None:
        if data[: len(CDR_START)] != CDR_START:
            raise DecodingError("a message in another encoding")
        self._data = memoryview(data)[len(CDR_START) :]
        self._at = 0

    def number(self, letter: str) -> float:
        """Read a number by its letter of `struct`."""
        number = NUMBERS[letter]
        self._at += -self._at % number.size
        return number.unpack(self._next_bytes(number.size))[0]  # type: ignore[no-any-return]

    def whole(self, letter: str = "q") -> int:
        """Read a whole number by its letter of `struct`."""
        return int(self.number(letter))

    def time_ns(self) -> int:
        """Read a builtin_interfaces/Time in ns."""
        seconds = self.whole("i")
        return seconds * 1_000_000_000 + self.whole("I")

    def text(self) -> str:
        """Read a string."""
        try:
            return bytes(self._next_bytes(self.whole("I"))).rstrip(b"\0").decode()
        except UnicodeDecodeError as exc:
            raise DecodingError("a text that is not UTF-8") from exc

    def octets(self) -> bytes:
        """Read a sequence of uint8."""
        return bytes(self._next_bytes(self.whole("I")))

    def texts(self) -> list[str]:
        """Read a sequence of strings."""
        return [self.text() for _ in range(self.whole("I"))]

    def wholes(self) -> list[int]:
        """Read a sequence of int64."""
        return [self.whole() for _ in range(self.whole("I"))]

    def skip(self, letter: str, count: int) -> None:
        """Pass an array of numbers."""
        for _ in range(count):
            self.number(letter)

    def _next_bytes(self, size: int) -> memoryview:
        end = self._at + size
        if end > len(self._data):
            raise DecodingError("a message that ends too early")
        taken, self._at = self._data[self._at : end], end
        return taken
