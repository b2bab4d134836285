"""A process with PyAV as the agent sees it: messages on its stdin and stdout, each after its length.

Of the encoder, of cameras and of raw images; it is killed at the end.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from importlib.util import find_spec

from robotether_agent.own_programs import program_environment
from robotether_agent.problems import DetailError
from robotether_agent.tasks import within
from robotether_agent.video.av_messages import LENGTH

# Time limit for the end of a process that was killed.
END_S = 5.0
PYAV_MISSING = "PyAV is not installed (sudo robotether-agent install-video)"

log = logging.getLogger(__name__)


class ProcessEndedError(DetailError):
    """The process has ended, or writes what makes no sense; the message says how."""


def has_pyav() -> bool:
    """Whether such a process can run here; looked at anew, as PyAV may be installed while the agent runs."""
    return find_spec("av") is not None


class AvProcess:
    """A running process."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process
        self._reads = asyncio.Lock()

    async def send(self, data: bytes) -> None:
        """Write `data`; the end of the process shows when its answer is read."""
        assert self._process.stdin is not None  # noqa: S101 - it is a pipe
        with suppress(ConnectionError):
            self._process.stdin.write(data)
            await self._process.stdin.drain()

    async def message(self, limit: int) -> bytes:
        """Return the next message, of at most `limit` bytes; ProcessEndedError where there is none."""
        assert self._process.stdout is not None  # noqa: S101 - it is a pipe
        try:
            async with self._reads:
                (length,) = LENGTH.unpack(await self._process.stdout.readexactly(LENGTH.size))
                if length > limit:
                    raise ProcessEndedError("its answer makes no sense")
                return await self._process.stdout.readexactly(length)
        except asyncio.IncompleteReadError as error:
            raise ProcessEndedError(await self._exit()) from error

    async def end(self) -> None:
        """Kill it, and wait until it is gone and its pipes are closed, also when this is cancelled meanwhile."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        with suppress(ProcessLookupError):
            self._process.kill()
        reaping = asyncio.ensure_future(within(END_S, self._read_to_end()))
        try:
            await asyncio.wait({reaping})
        except asyncio.CancelledError:
            await asyncio.wait({reaping})
            raise
        finally:
            if not reaping.cancelled() and reaping.exception() is not None:
                log.warning("process %d was killed and is still there", self._process.pid)

    async def _read_to_end(self) -> None:
        # Whoever waits for a message sees its end first.
        async with self._reads:
            await self._process.communicate()

    async def _exit(self) -> str:
        try:
            code = await within(END_S, self._process.wait())
        except asyncio.TimeoutError:
            return "it has closed its output"
        return f"exit code {code}" if code >= 0 else signal.Signals(-code).name


@asynccontextmanager
async def av_process(command: Sequence[str]) -> AsyncIterator[AvProcess]:
    """Start a process, and kill it at the end; OSError where it cannot be started."""
    process = AvProcess(
        await asyncio.create_subprocess_exec(
            *command,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            env=program_environment(os.environ),
        )
    )
    try:
        yield process
    finally:
        await process.end()
