"""One run of the guard, as the agent sees it: a process with JSON lines on stdin and stdout, forked by a `ForkServer`.

Started by robotether_agent.guard.supervisor. The guard is never left running without an agent: it is asked to stop
the robot and end, and what does not follow is killed. Its log goes where the agent's goes.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import time
from asyncio import StreamReaderProtocol
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from typing import NoReturn

from robotether_agent.fields import FieldError, JsonObject, line_of, parse_object
from robotether_agent.guard.fork_server import START_S, ForkServer, ignore_failure
from robotether_agent.problems import GuardDownError
from robotether_agent.tasks import first_of, within

TICK_S = 0.2
SILENCE_S = 0.6
# Time limit for a guard's exit; it first publishes zeros for 0.5 s.
EXIT_S = 1.5
MAX_LINE_BYTES = 64 * 1024
MAX_UNREAD_BYTES = 64 * 1024
TICK = {"type": "tick"}

log = logging.getLogger(__name__)


class SilenceDetector:
    """Whether the guard has been silent for too long.

    Time in which the agent itself did not run does not count: what the guard said meanwhile is still unread.
    """

    def __init__(self, now: float) -> None:
        self._checked_at = now
        self._line_at = now
        self._limit_s = START_S

    def on_line(self, now: float) -> None:
        """Note a line of the guard."""
        self._line_at = now
        self._limit_s = SILENCE_S

    def is_lost(self, now: float) -> bool:
        """Return whether it was silent for too long; to be asked every TICK_S or more often."""
        was_paused = now - self._checked_at > 2 * TICK_S
        self._checked_at = now
        if was_paused:
            self._line_at = now
        return self.left_s(now) < 0

    def left_s(self, now: float) -> float:
        """Return for how many seconds it may still be silent; negative: it was for too long."""
        return self._line_at + self._limit_s - now


class GuardProcess:
    """A running guard."""

    def __init__(
        self,
        server: ForkServer,
        pid: int,
        to_guard: asyncio.WriteTransport,
        from_guard: asyncio.ReadTransport,
        lines: asyncio.StreamReader,
    ) -> None:
        self.pid = pid
        self._server = server
        self._to_guard = to_guard
        self._from_guard = from_guard
        self._lines = lines
        self._clock = time.monotonic
        self._silence = SilenceDetector(self._clock())
        self._is_killed = False
        self._exit_code_asked: asyncio.Future[int] | None = None

    @classmethod
    async def start(cls, server: ForkServer) -> GuardProcess:
        """Have a guard forked; whether it works shows when it says so.

        Raises GuardDownError, or OSError where the agent has no pipes for one.
        """
        with ExitStack() as guards, ExitStack() as unless_started:
            stdin, to_guard = os.pipe()
            guards.enter_context(os.fdopen(stdin))
            writes = unless_started.enter_context(os.fdopen(to_guard, "wb", 0))
            from_guard, stdout = os.pipe()
            guards.enter_context(os.fdopen(stdout, "wb"))
            reads = unless_started.enter_context(os.fdopen(from_guard, "rb", 0))
            pid = await server.guard(stdin, stdout)
            unless_started.pop_all()
        loop = asyncio.get_running_loop()
        lines = asyncio.StreamReader(limit=MAX_LINE_BYTES)
        listening, _ = await loop.connect_read_pipe(lambda: StreamReaderProtocol(lines), reads)
        writing, _ = await loop.connect_write_pipe(asyncio.BaseProtocol, writes)
        return cls(server, pid, writing, listening, lines)

    def send(self, message: Mapping[str, object]) -> None:
        """Send one line; one that does not get through shows as the guard's end or silence."""
        if self._to_guard.is_closing():
            return
        if self._to_guard.get_write_buffer_size() > MAX_UNREAD_BYTES:
            log.warning("the guard reads nothing: killing it")
            self._kill()
            return
        self._to_guard.write(line_of(message))

    def offer(self, message: Mapping[str, object]) -> None:
        """Send one line of many, unless the guard is late with those before."""
        if not self._to_guard.get_write_buffer_size():
            self.send(message)

    async def serve(self, on_line: Callable[[JsonObject], None]) -> NoReturn:
        """Tick, and hand on each line of the guard; raise GuardDownError when it has ended or hangs."""
        await first_of(self._listen(on_line), self._tick())
        raise GuardDownError(await self._why_ended())

    async def end(self) -> None:
        """Let the guard stop the robot and end; kill it if it does not, or if this wait is cut short."""
        if self._is_killed:
            return
        try:
            self.send({"type": "exit"})
            self._to_guard.close()
            await within(EXIT_S, self._read_all())
            await asyncio.wait({self._exit_code()}, timeout=TICK_S)
        except asyncio.TimeoutError:
            log.warning("the guard did not end within %.1f s: killing it", EXIT_S)
        finally:
            await self.kill()

    async def kill(self) -> None:
        """End the guard at once; the next one stops the robot."""
        self._is_killed = True
        self._kill()
        # Its exit code is asked for and not waited for: a fork server that hangs must not keep the next guard.
        self._exit_code()
        with suppress(asyncio.TimeoutError):
            await within(EXIT_S, self._read_all())
        if not self._to_guard.is_closing():
            self._to_guard.abort()
        self._from_guard.close()

    async def _read_all(self) -> None:
        """Read until the end of its output, which is its own end."""
        while await self._lines.read(MAX_LINE_BYTES):
            pass

    async def _listen(self, on_line: Callable[[JsonObject], None]) -> None:
        while line := await self._line():
            self._silence.on_line(self._clock())
            try:
                on_line(parse_object(line, "the line"))
            except FieldError as error:
                raise GuardDownError(f"the guard sent an invalid line: {error}") from error

    async def _line(self) -> bytes:
        """Return the next line, or nothing at the guard's end."""
        try:
            return await self._lines.readuntil(b"\n")
        except asyncio.IncompleteReadError:
            return b""
        except asyncio.LimitOverrunError as error:
            raise GuardDownError("the guard sent a line over 64 KiB") from error

    async def _tick(self) -> None:
        while not self._silence.is_lost(self._clock()):
            self.send(TICK)
            # A guard that hangs is noticed when its time is over, not with the tick that follows.
            await asyncio.sleep(min(TICK_S, self._silence.left_s(self._clock())))
        raise GuardDownError("the guard hangs")

    async def _why_ended(self) -> str:
        await asyncio.wait({self._exit_code()}, timeout=TICK_S)
        if not self._exit_code().done():
            return "the guard closed its output"
        code = self._known_exit_code()
        if code is None:
            return "the guard ended, and its fork server before it"
        if code < 0:
            return f"the guard was ended by {signal.Signals(-code).name}"
        return f"the guard ended with status {code}"

    def _exit_code(self) -> asyncio.Future[int]:
        if self._exit_code_asked is None:
            self._exit_code_asked = asyncio.ensure_future(self._server.exit_code(self.pid))
            ignore_failure(self._exit_code_asked)
        return self._exit_code_asked

    def _known_exit_code(self) -> int | None:
        code = self._exit_code_asked
        if code is None or not code.done() or code.cancelled() or code.exception() is not None:
            return None
        return code.result()

    def _kill(self) -> None:
        if self._known_exit_code() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
