"""A guard process together with the task that listens to it: first on the bench, then the robot's guard.

Made by robotether_agent.guard_keeper. On the bench a guard has no orders and does nothing; it only spares the next
robot in motion the time in which Python starts, seconds on a small computer.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from typing import NoReturn

from robotether_agent.fields import FieldError, JsonObject
from robotether_agent.guard_process import GuardProcess
from robotether_agent.problems import GuardDown

OnLine = Callable[[JsonObject], None]


class GuardLife:
    """One guard from its start to its end."""

    def __init__(self, process: GuardProcess) -> None:
        self._process = process
        self._on_line: OnLine | None = None
        # What it said on the bench: the newest line of each kind.
        self._said: dict[object, JsonObject] = {}
        self._serving = asyncio.ensure_future(process.serve(self._hear))

    @classmethod
    async def start(cls, command: Sequence[str]) -> GuardLife:
        """Start a guard on the bench."""
        return cls(await GuardProcess.start(command))

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def is_fit(self, *, stopped: bool) -> bool:
        """Tell whether it could take over now, knowing that the robot is stopped or is not."""
        state = self._said.get("guard", {})
        ready = "ready" in self._said and not self._serving.done()
        return ready and state.get("stopped") is stopped

    def send(self, message: Mapping[str, object]) -> None:
        """Send one line."""
        self._process.send(message)

    def take_over(self, on_line: OnLine) -> None:
        """Leave the bench: hand on what it has said already, and each line from now on."""
        self._on_line = on_line
        try:
            for message in [self._said[kind] for kind in ("ready", "guard") if kind in self._said]:
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
            await self._hear_no_more()
        finally:
            await self._process.end()

    async def kill(self) -> None:
        """End it at once."""
        try:
            await self._hear_no_more()
        finally:
            await self._process.kill()

    async def _hear_no_more(self) -> None:
        self._serving.cancel()
        await asyncio.wait({self._serving})
        if not self._serving.cancelled():
            # Looked at, so that asyncio does not report it as lost.
            self._serving.exception()

    def _hear(self, message: JsonObject) -> None:
        if self._on_line is not None:
            self._on_line(message)
        elif message.get("type") in {"ready", "guard"}:
            self._said[message["type"]] = message
