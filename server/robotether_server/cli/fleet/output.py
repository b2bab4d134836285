"""Passes on what robots print: whole lines, each with its robot's name, never two mixed.

Control characters are shown, not sent: a robot must not steer the terminal of the person who asked it something.
"""

from threading import Lock
from typing import Protocol, TextIO

MAX_LINE_LENGTH = 16 * 1024
MAX_CAPTURED_LENGTH = 1024 * 1024

_SHOWN = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160)) if chr(code) != "\t"}


class Sink(Protocol):
    """Where one output of one robot goes."""

    def write(self, text: str) -> None:
        """Take the next piece."""

    def close(self) -> None:
        """Take notice that there is no more."""


class Lines:
    """One robot's standard output or error, which comes in pieces."""

    def __init__(self, prefix: str, to: TextIO, lock: Lock) -> None:
        self._prefix = prefix
        self._to = to
        self._lock = lock
        self._rest = ""

    def write(self, text: str) -> None:
        """Pass on the lines that are whole now; one without an end is cut at MAX_LINE_LENGTH."""
        *lines, rest = (self._rest + text).split("\n")
        while len(rest) > MAX_LINE_LENGTH:
            lines.append(rest[:MAX_LINE_LENGTH])
            rest = rest[MAX_LINE_LENGTH:]
        self._rest = rest
        self._pass_on(lines)

    def close(self) -> None:
        """Pass on a last line without an end."""
        rest, self._rest = self._rest, ""
        if rest:
            self._pass_on([rest])

    def _pass_on(self, lines: list[str]) -> None:
        with self._lock:
            for line in lines:
                self._to.write(f"{self._prefix}{line.removesuffix(chr(13)).translate(_SHOWN)}\n")
            self._to.flush()


class Captured:
    """The first MAX_CAPTURED_LENGTH characters of an output, for --json."""

    def __init__(self) -> None:
        self.text = ""
        self.cut = False

    def write(self, text: str) -> None:
        """Keep what has room."""
        room = MAX_CAPTURED_LENGTH - len(self.text)
        self.text += text[:room]
        self.cut = self.cut or len(text) > room

    def close(self) -> None:
        """There is nothing more to come."""
