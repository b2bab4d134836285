"""The agent as a whole with its guard in the same process: what hundreds of robots on one machine are made of.

The guard's own code runs, between the same two interfaces as in its process: the agent's lines and rosbridge. Only what
a process of its own is for is missing: a robot whose agent hangs is not stopped here. Used by the fleet's workers.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from robotether_agent.daemon import Agent
from robotether_agent.fields import JsonObject, line_of, parse_object
from robotether_agent.guard.agent_messages import GuardReporter
from robotether_agent.guard.child_process import EXIT_S, TICK, TICK_S, GuardHandle
from robotether_agent.guard.process import MAX_LINE_BYTES, Guard
from robotether_agent.guard.rosbridge import new_http
from robotether_agent.guard.supervisor import GuardSupervisor
from robotether_agent.problems import GuardDown
from robotether_agent.settings import Settings
from robotether_agent.tasks import first_of


class _Pipe(asyncio.WriteTransport):
    """The guard's standard output, as a queue of lines."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: asyncio.Queue[bytes] = asyncio.Queue()

    def is_closing(self) -> bool:
        return False

    def get_write_buffer_size(self) -> int:
        return 0

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.lines.put_nowait(bytes(data))


class GuardHere:
    """A running guard, as GuardProcess is one."""

    pid = os.getpid()

    def __init__(self, state_dir: Path, run_dir: Path) -> None:
        self._messages = asyncio.StreamReader(limit=MAX_LINE_BYTES)
        self._pipe = _Pipe()
        self._life = asyncio.ensure_future(self._run(state_dir, run_dir))

    def send(self, message: Mapping[str, object]) -> None:
        """Send one line."""
        self._messages.feed_data(line_of(message))

    async def serve(self, on_line: Callable[[JsonObject], None]) -> NoReturn:
        """Tick, and hand on each line of the guard; raise GuardDown when it has ended."""
        await first_of(self._until_end(), self._listen(on_line), self._tick())
        raise GuardDown("the guard ended")

    async def end(self) -> None:
        """Let the guard stop the robot and end."""
        self.send({"type": "exit"})
        await asyncio.wait({self._life}, timeout=EXIT_S)
        await self.kill()

    async def kill(self) -> None:
        """End the guard at once."""
        self._life.cancel()
        await asyncio.gather(self._life, return_exceptions=True)

    async def _run(self, state_dir: Path, run_dir: Path) -> None:
        async with new_http() as http:
            await Guard(http, state_dir, run_dir, GuardReporter(self._pipe)).run(self._messages)

    async def _until_end(self) -> None:
        await asyncio.wait({self._life})
        with suppress(asyncio.CancelledError):
            self._life.result()

    async def _listen(self, on_line: Callable[[JsonObject], None]) -> None:
        while True:
            on_line(parse_object(await self._pipe.lines.get(), "the line"))

    async def _tick(self) -> None:
        while True:
            self.send(TICK)
            await asyncio.sleep(TICK_S)


class _SupervisorHere(GuardSupervisor):
    """Keeps a guard in this process, and none as a hot spare: Python need not start for it."""

    def __init__(self, settings: Settings, **others: object) -> None:
        super().__init__(settings.rosbridge_url, (), **others)  # type: ignore[arg-type] # the supervisor's own
        self._directories = settings.state_dir, settings.run_dir

    async def _next_guard(self) -> GuardHandle:
        return GuardHandle(GuardHere(*self._directories))  # type: ignore[arg-type] # has all that it uses

    async def _keep_spare(self) -> NoReturn:
        await asyncio.Event().wait()
        raise AssertionError


class LightAgent(Agent):
    """The agent, all of it; its guard is no process of its own."""

    def _supervisor(self) -> GuardSupervisor:
        return _SupervisorHere(self._settings, on_change=self._show_guard)
