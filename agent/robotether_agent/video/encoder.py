"""Keeps the encoder of one camera running, as a process of its own, and asks it for frames.

Started by a receiver's `frame_encoder`, which sends JPEGs meanwhile and whenever this fails. Nothing that stops the
robot waits for it.

    encoder = VideoEncoder(on_change)
    await encoder.run()             # until cancelled: starts the process, and again after it failed
    await encoder.encode(request)   # once `down_reason` is empty
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import sys
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from importlib.util import find_spec
from typing import NoReturn

from robotether_common.frames import ENCODER_STARTS

from robotether_agent.clock import robot_time
from robotether_agent.own_programs import program_environment
from robotether_agent.tasks import within
from robotether_agent.video.encoder_messages import (
    LENGTH,
    MAX_ANSWER_BYTES,
    EncodedFrame,
    EncodeRequest,
    EncoderError,
    FrameRefusedError,
    unpacked_answer,
)

COMMAND = (sys.executable, "-m", "robotether_agent.video.encoder_process")
MIN_CORES = 2
# Time limits for the process's start, for a frame, and for the end of one that was killed.
START_S, ANSWER_S, END_S = 20.0, 3.0, 5.0
# Pause after a failure, doubled after each, and its maximum.
PAUSE_S, MAX_PAUSE_S = 2.0, 120.0
# Time after which a process that fails has been well before.
STABLE_S = 60.0
# Number of frames refused in a row after which the process ends.
MAX_REFUSALS = 3

log = logging.getLogger(__name__)


def availability(setting: str) -> str:
    """Return why this robot cannot encode video, by the setting `video_encoder`; nothing where it can."""
    if setting == "off":
        return "the setting video_encoder is off"
    if find_spec("av") is None:
        return "PyAV is not installed (sudo robotether-agent install-video)"
    if (os.cpu_count() or 1) < MIN_CORES:
        return "this robot has one processor core"
    return ""


class VideoEncoder:
    """One camera's encoder; `on_change` is called whenever `down_reason` changes."""

    def __init__(
        self,
        on_change: Callable[[], None],
        command: Sequence[str] = COMMAND,
        clock: Callable[[], float] = robot_time,
    ) -> None:
        self.down_reason = ENCODER_STARTS
        self._on_change = on_change
        self._command = command
        self._clock = clock
        self._process: asyncio.subprocess.Process | None = None
        self._reads = asyncio.Lock()
        self._failure: asyncio.Future[str] | None = None
        self._pause_s, self._min_pause_s = PAUSE_S, 0.0
        self._refusals = 0
        # Its driver may be what ended a process.
        self._allows_hardware = True

    async def run(self) -> NoReturn:
        """Keep a process running until this is cancelled, which ends it; after each failure it pauses longer."""
        try:
            while True:
                started_s, self._min_pause_s = self._clock(), 0.0
                reason = await self._run_once()
                self._change(reason)
                pause_s = self._pause(self._clock() - started_s)
                log.warning("no encoder for %g s: %s", pause_s, reason)
                await asyncio.sleep(pause_s)
        finally:
            self.down_reason = ENCODER_STARTS

    async def encode(self, request: EncodeRequest) -> EncodedFrame:
        """Return the frame; FrameRefusedError for one that cannot be encoded, EncoderError if no other can either."""
        process = self._process
        if process is None:
            raise EncoderError(self.down_reason)
        try:
            frame = await self._answer(process, request)
        except FrameRefusedError as refused:
            self._refusals += 1
            if self._refusals >= MAX_REFUSALS:
                self.fail(str(refused))
            raise
        except EncoderError as error:
            # Else it was ended here.
            if self._process is process:
                self._allows_hardware = False
                self.fail(str(error))
            raise
        self._refusals = 0
        return frame

    def fail(self, reason: str, *, min_pause_s: float = 0.0) -> None:
        """End the process, and start one again after a pause."""
        self._process = None
        self._min_pause_s = min_pause_s
        self._change(reason)
        if self._failure is not None and not self._failure.done():
            self._failure.set_result(reason)

    async def _run_once(self) -> str:
        """Run a process until it fails, and return why it did."""
        try:
            async with self._running():
                return await self._failed()
        except (EncoderError, OSError) as error:
            return str(error)

    def _pause(self, ran_s: float) -> float:
        if ran_s > STABLE_S:
            self._pause_s = PAUSE_S
        pause_s, self._pause_s = self._pause_s, min(MAX_PAUSE_S, 2 * self._pause_s)
        return max(pause_s, self._min_pause_s)

    async def _failed(self) -> str:
        self._failure = asyncio.get_running_loop().create_future()
        return await self._failure

    def _change(self, reason: str) -> None:
        if reason != self.down_reason:
            self.down_reason = reason
            self._on_change()

    @asynccontextmanager
    async def _running(self) -> AsyncIterator[None]:
        """Start a process, and kill it at the end."""
        process = await asyncio.create_subprocess_exec(
            *self._command,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            env=program_environment(os.environ),
        )
        try:
            await self._until_ready(process)
            self._process, self._refusals = process, 0
            self._change("")
            yield
        finally:
            self._process = None
            _kill(process)
            await self._reap(process)

    async def _reap(self, process: asyncio.subprocess.Process) -> None:
        """Wait until a killed process is gone and its pipes are closed, also when this is cancelled meanwhile."""
        reaping = asyncio.ensure_future(within(END_S, self._read_to_end(process)))
        try:
            await asyncio.wait({reaping})
        except asyncio.CancelledError:
            await asyncio.wait({reaping})
            raise
        finally:
            if not reaping.cancelled() and reaping.exception() is not None:
                log.warning("an encoder that was killed is still there")

    async def _read_to_end(self, process: asyncio.subprocess.Process) -> None:
        # Whoever reads its answer sees its end first.
        async with self._reads:
            await process.communicate()

    async def _until_ready(self, process: asyncio.subprocess.Process) -> None:
        """Wait for its first message, which is empty."""
        try:
            await within(START_S, _message(process))
        except asyncio.TimeoutError as error:
            raise EncoderError(f"the encoder did not start within {START_S:g} s") from error

    async def _answer(
        self, process: asyncio.subprocess.Process, request: EncodeRequest
    ) -> EncodedFrame:
        if not self._allows_hardware:
            request = replace(request, allows_hardware=False)
        try:
            async with self._reads:
                answer = await within(ANSWER_S, _ask(process, request.packed()))
            return unpacked_answer(answer)
        except asyncio.TimeoutError as error:
            raise EncoderError(f"the encoder made no frame within {ANSWER_S:g} s") from error


async def _ask(process: asyncio.subprocess.Process, message: bytes) -> bytes:
    assert process.stdin is not None  # noqa: S101 - it is a pipe
    with suppress(ConnectionError):
        # Its end shows when it is read.
        process.stdin.write(message)
        await process.stdin.drain()
    return await _message(process)


async def _message(process: asyncio.subprocess.Process) -> bytes:
    """Return the next message of a process; EncoderError where it has ended."""
    assert process.stdout is not None  # noqa: S101 - it is a pipe
    try:
        (length,) = LENGTH.unpack(await process.stdout.readexactly(LENGTH.size))
        if length > MAX_ANSWER_BYTES:
            raise EncoderError("the encoder's answer makes no sense")
        return await process.stdout.readexactly(length)
    except asyncio.IncompleteReadError as error:
        raise EncoderError(f"the encoder ended: {await _exit_of(process)}") from error


async def _exit_of(process: asyncio.subprocess.Process) -> str:
    try:
        code = await within(END_S, process.wait())
    except asyncio.TimeoutError:
        return "it has closed its output"
    return f"exit code {code}" if code >= 0 else signal.Signals(-code).name


def _kill(process: asyncio.subprocess.Process) -> None:
    if process.stdin is not None:
        process.stdin.close()
    with suppress(ProcessLookupError):
        process.kill()
