"""Keeps the encoder of one camera running, as a process of its own, and asks it for frames.

Started by a receiver's `frame_encoder`, which sends JPEGs meanwhile and whenever this fails. Nothing that stops the
robot waits for it.

    encoder = VideoEncoder(on_change, "/camera/image_raw")
    await encoder.run()             # until cancelled: starts the process, and again after it failed
    await encoder.encode(request)   # once `down_reason` is empty
"""

from __future__ import annotations

import asyncio
import logging
import os
import sys
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import NoReturn

from robotether_common.frames import ENCODER_STARTS

from robotether_agent.clock import robot_time
from robotether_agent.tasks import within
from robotether_agent.video.av_process import (
    PYAV_MISSING,
    AvProcess,
    ProcessEndedError,
    av_process,
    has_pyav,
)
from robotether_agent.video.encoder_messages import (
    MAX_ANSWER_BYTES,
    EncodedFrame,
    EncodeRequest,
    EncoderError,
    FrameRefusedError,
    unpacked_answer,
)

COMMAND = (sys.executable, "-m", "robotether_agent.video.encoder_process")
MIN_CORES = 2
# Time limits for the process's start, and for a frame.
START_S, ANSWER_S = 20.0, 3.0
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
    if not has_pyav():
        return PYAV_MISSING
    # Of those that the service or its container may use.
    if len(os.sched_getaffinity(0)) < MIN_CORES:
        return "this robot has one processor core"
    return ""


class VideoEncoder:
    """The encoder of `camera`; `on_change` is called whenever `down_reason` changes."""

    def __init__(
        self,
        on_change: Callable[[], None],
        camera: str,
        command: Sequence[str] = COMMAND,
        clock: Callable[[], float] = robot_time,
    ) -> None:
        self.down_reason = ENCODER_STARTS
        self._on_change = on_change
        self._camera = camera
        self._command = command
        self._clock = clock
        self._process: AvProcess | None = None
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
                log.warning("no encoder of %s for %g s: %s", self._camera, pause_s, reason)
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
        except (EncoderError, ProcessEndedError, OSError) as error:
            return _reason(error)

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
        async with av_process(self._command) as process:
            try:
                await self._until_ready(process)
                self._process, self._refusals = process, 0
                self._change("")
                yield
            finally:
                self._process = None

    async def _until_ready(self, process: AvProcess) -> None:
        """Wait for its first message, which is empty."""
        try:
            await within(START_S, process.message(MAX_ANSWER_BYTES))
        except asyncio.TimeoutError as error:
            raise EncoderError(f"the encoder did not start within {START_S:g} s") from error

    async def _answer(self, process: AvProcess, request: EncodeRequest) -> EncodedFrame:
        if not self._allows_hardware:
            request = replace(request, allows_hardware=False)
        try:
            return unpacked_answer(await within(ANSWER_S, _ask(process, request.packed())))
        except asyncio.TimeoutError as error:
            raise EncoderError(f"the encoder made no frame within {ANSWER_S:g} s") from error
        except ProcessEndedError as error:
            raise EncoderError(_reason(error)) from error


async def _ask(process: AvProcess, message: bytes) -> bytes:
    await process.send(message)
    return await process.message(MAX_ANSWER_BYTES)


def _reason(error: Exception) -> str:
    return f"the encoder ended: {error}" if isinstance(error, ProcessEndedError) else str(error)
