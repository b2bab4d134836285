"""One run of the guard, as the agent sees it: a child process with JSON lines on stdin and stdout.

Started by robotether_agent.guard.supervisor. The guard is never left running without an agent: it is asked to stop
the robot and end, and what does not follow is killed. Its log goes where the agent's goes.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import sys
import time
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NoReturn

import robotether_common

import robotether_agent
from robotether_agent.fields import FieldError, JsonObject, line_of, parse_object
from robotether_agent.problems import GuardDown
from robotether_agent.tasks import first_of, within

TICK_S = 0.2
SILENCE_S = 0.6
# Until its first word; a small computer that boots needs seconds to load Python.
START_S = 20.0
# It publishes zeros for 0.5 s before it ends.
EXIT_S = 1.5
MAX_LINE_BYTES = 64 * 1024
MAX_UNREAD_BYTES = 64 * 1024
# Where the guard's packages lie: one folder once they are installed, two in a checkout.
PACKAGE_PARENTS = tuple(
    dict.fromkeys(
        str(Path(package.__path__[0]).resolve().parent)
        for package in (robotether_agent, robotether_common)
    )
)
# What only the agent itself may say to systemd.
NOT_INHERITED = frozenset({"NOTIFY_SOCKET", "WATCHDOG_PID", "WATCHDOG_USEC"})
TICK = {"type": "tick"}
OnLine = Callable[[JsonObject], None]

log = logging.getLogger(__name__)


def guard_command(state_dir: Path, run_dir: Path, log_level: str) -> list[str]:
    """Return the command of the guard, by the Python that runs the agent."""
    arguments = ["--state-dir", str(state_dir), "--run-dir", str(run_dir)]
    return [sys.executable, "-m", "robotether_agent.guard", *arguments, "--log-level", log_level]


def guard_environment(environ: Mapping[str, str]) -> dict[str, str]:
    """Return the agent's environment, but for its settings: the guard needs no join token.

    The guard is the one that came with this agent, whatever else Python would find.
    """
    inherited = {
        name: value
        for name, value in environ.items()
        if not name.startswith("ROBOTETHER_") and name not in NOT_INHERITED
    }
    paths = [*PACKAGE_PARENTS, *filter(None, [environ.get("PYTHONPATH")])]
    return {**inherited, "PYTHONPATH": os.pathsep.join(paths)}


class SilenceDetector:
    """Whether the guard has been silent for too long.

    Time in which the agent itself stood still does not count: what the guard said meanwhile is still unread.
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
        """Tell whether it was silent for too long; to be asked every TICK_S or more often."""
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

    def __init__(self, process: Process, clock: Callable[[], float] = time.monotonic) -> None:
        if process.stdin is None or process.stdout is None:
            raise ValueError("the guard must run with two pipes")
        self._in = process.stdin
        self._out = process.stdout
        self._process = process
        self._clock = clock
        self._silence = SilenceDetector(clock())

    @classmethod
    async def start(cls, command: Sequence[str]) -> GuardProcess:
        """Start the guard; whether it works shows when it says so."""
        try:
            process = await asyncio.create_subprocess_exec(
                *command,
                stdin=PIPE,
                stdout=PIPE,
                limit=MAX_LINE_BYTES,
                env=guard_environment(os.environ),
                # A Ctrl-C in the terminal is for the agent, which then lets the guard stop the robot.
                start_new_session=True,
            )
        except OSError as error:
            raise GuardDown(f"cannot start the guard: {error.strerror}") from error
        return cls(process)

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def send(self, message: Mapping[str, object]) -> None:
        """Send one line; one that does not get through shows as the guard's end or silence."""
        if self._in.is_closing():
            return
        if self._in.transport.get_write_buffer_size() > MAX_UNREAD_BYTES:
            log.warning("the guard reads nothing: killing it")
            self._kill()
            return
        self._in.write(line_of(message))

    async def serve(self, on_line: Callable[[JsonObject], None]) -> NoReturn:
        """Tick, and hand on each line of the guard; raise GuardDown when it has ended or hangs."""
        await first_of(self._listen(on_line), self._tick())
        raise GuardDown(await self._why_ended())

    async def end(self) -> None:
        """Let the guard stop the robot and end; kill it if it does not, or if this wait is cut short."""
        try:
            if self._process.returncode is None:
                self.send({"type": "exit"})
                self._in.close()
                await within(EXIT_S, self._gone())
        except asyncio.TimeoutError:
            log.warning("the guard did not end within %.1f s: killing it", EXIT_S)
        finally:
            self._kill()
        await self._gone()

    async def kill(self) -> None:
        """End the guard at once; the next one stops the robot."""
        self._kill()
        await self._gone()

    async def _gone(self) -> None:
        """Wait for the end of its output, without which asyncio sees no end of the process, and for its own."""
        while await self._out.read(MAX_LINE_BYTES):
            pass
        await self._process.wait()

    async def _listen(self, on_line: Callable[[JsonObject], None]) -> None:
        while line := await self._line():
            self._silence.on_line(self._clock())
            try:
                on_line(parse_object(line, "the line"))
            except FieldError as error:
                raise GuardDown(f"the guard sent an invalid line: {error}") from error

    async def _line(self) -> bytes:
        """Return the next line, or nothing at the guard's end."""
        try:
            return await self._out.readuntil(b"\n")
        except asyncio.IncompleteReadError:
            return b""
        except asyncio.LimitOverrunError as error:
            raise GuardDown("the guard sent a line over 64 KiB") from error

    async def _tick(self) -> None:
        while not self._silence.is_lost(self._clock()):
            self.send(TICK)
            # A guard that hangs is noticed when its time is over, not with the tick that follows.
            await asyncio.sleep(min(TICK_S, self._silence.left_s(self._clock())))
        raise GuardDown("the guard hangs")

    async def _why_ended(self) -> str:
        try:
            status = await within(TICK_S, self._process.wait())
        except asyncio.TimeoutError:
            return "the guard closed its output"
        if status < 0:
            return f"the guard was ended by {signal.Signals(-status).name}"
        return f"the guard ended with status {status}"

    def _kill(self) -> None:
        if self._process.returncode is None:
            try:
                # Not Process.kill(), which looks for the end first and then takes it from asyncio.
                os.kill(self._process.pid, signal.SIGKILL)
            except ProcessLookupError:
                log.debug("guard %d has ended already", self._process.pid)


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
            raise GuardDown(f"the guard sent an invalid line: {error}") from error

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
