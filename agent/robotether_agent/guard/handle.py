"""A guard process together with the task that listens to it: first as a hot spare, then the robot's guard.

Made by robotether_agent.guard.supervisor. A spare has no settings and does nothing; it only spares the next robot in
motion the time in which Python starts, seconds on a small computer.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from typing import NoReturn

from robotether_agent.fields import FieldError, JsonObject
from robotether_agent.guard.child_process import GuardProcess
from robotether_agent.problems import GuardDown

OnLine = Callable[[JsonObject], None]


class GuardHandle:
    """One guard from its start to its end."""

    def __init__(self, process: GuardProcess) -> None:
        self._process = process
        self._on_line: OnLine | None = None
        # What it said as a hot spare: the newest line of each kind.
        self._spare_lines: dict[object, JsonObject] = {}
        self._serving = asyncio.ensure_future(process.serve(self._receive))

    @classmethod
    async def start(cls, command: Sequence[str]) -> GuardHandle:
        """Start a guard as a hot spare."""
        return cls(await GuardProcess.start(command))

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def is_fit(self, *, stopped: bool) -> bool:
        """Tell whether it could take over now, knowing that the robot is stopped or is not."""
        state = self._spare_lines.get("guard", {})
        ready = "ready" in self._spare_lines and not self._serving.done()
        return ready and state.get("stopped") is stopped

    def send(self, message: Mapping[str, object]) -> None:
        """Send one line."""
        self._process.send(message)

    def activate(self, on_line: OnLine) -> None:
        """Be a spare no more: hand on what it has said already, and each line from now on."""
        self._on_line = on_line
        try:
            for message in [
                self._spare_lines[kind] for kind in ("ready", "guard") if kind in self._spare_lines
            ]:
                on_line(message)
        except FieldError as error:
            raise GuardDown(f"the guard said what cannot be understood: {error}") from error

    async def ended(self, within_s: float | None = None) -> None:
        """Wait for its end and raise GuardDown, or return after `within_s`."""
        await asyncio.wait({self._serving}, timeout=within_s)
        if self._serving.done():
            self._serving.result()

    async def until_end(self) -> NoReturn:
        """Raise GuardDown when it has ended."""
        while True:
            await self.ended()

    async def end(self) -> None:
        """Let it stop the robot and end."""
        try:
            await self._stop_receiving()
        finally:
            await self._process.end()

    async def kill(self) -> None:
        """End it at once."""
        try:
            await self._stop_receiving()
        finally:
            await self._process.kill()

    async def _stop_receiving(self) -> None:
        self._serving.cancel()
        await asyncio.wait({self._serving})
        if not self._serving.cancelled():
            # Looked at, so that asyncio does not report it as lost.
            self._serving.exception()

    def _receive(self, message: JsonObject) -> None:
        if self._on_line is not None:
            self._on_line(message)
        elif message.get("type") in {"ready", "guard"}:
            self._spare_lines[message["type"]] = message
