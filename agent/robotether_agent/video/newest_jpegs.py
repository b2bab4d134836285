"""Makes JPEGs of a camera's newest frames, in a process of its own: a thread reads, another makes JPEGs.

A frame that arrives while a JPEG is made replaces the waiting one, so that no frame is old. Shared by
`camera_process` and `image_process`.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, BinaryIO

import av
from robotether_common.frames import MAX_FRAME_BYTES

from robotether_agent.problems import DetailError
from robotether_agent.video.av_messages import FRAME, FRAME_HEADER, REASON, framed
from robotether_agent.video.av_program import MAX_DATA_BYTES, private_output, step_back

# Default quantiser of JPEGs, of 2 (best) to 31: about quality 90.
JPEG_QUANTISER = 3


class CameraFailedError(DetailError):
    """The camera gives no frames; the message says why, without its URL."""


def reason_of(error: Exception) -> str:
    """Return why there are no frames. Of FFmpeg's words the reason alone: the rest may have the camera's URL."""
    if isinstance(error, DetailError):
        return error.message
    if isinstance(error, MemoryError):
        limit_mb = MAX_DATA_BYTES // 2**20
        return f"it needs more than the {limit_mb} MB that video may use; 1920x1080 pixels do not"
    return getattr(error, "strerror", None) or "its frames cannot be read"


def decoded(context: Any, packet: Any) -> list[Any]:
    """Return the frames of a packet, none of a broken one: a lost part costs no more than the frame."""
    try:
        return list(context.decode(packet))
    except av.InvalidDataError:
        return []


@dataclass(frozen=True)
class DecodedFrame:
    """A frame with its times on the robot's clock; `content` is a JPEG already, PyAV's frame, or what makes that."""

    content: Any
    arrived_s: float
    timestamp_s: float
    is_stamped: bool = False


class NewestFrame:
    """Hands the newest frame from the thread that reads to the one that makes JPEGs."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._frame: DecodedFrame | None = None
        self._end: Exception | None = None

    def put(self, frame: DecodedFrame) -> None:
        """Replace the frame."""
        with self._condition:
            self._frame = frame
            self._condition.notify()

    def end(self, error: Exception) -> None:
        """There are no more frames."""
        with self._condition:
            self._end = error
            self._condition.notify()

    def next(self) -> DecodedFrame:
        """Return a frame that was not returned before; raise why there are no more."""
        with self._condition:
            self._condition.wait_for(lambda: self._frame is not None or self._end is not None)
            frame, self._frame = self._frame, None
            if frame is None:
                raise self._end or CameraFailedError("it ended")
            return frame


class JpegMaker:
    """Makes a JPEG of a decoded frame."""

    def __init__(self) -> None:
        self._context: Any = None

    def jpeg(self, frame: Any) -> bytes:
        """Return a frame as a JPEG of its own size."""
        if isinstance(frame, bytes):
            return frame
        if callable(frame):
            frame = frame()
        full = frame.reformat(format="yuvj420p", dst_color_range=2, threads=1)
        if self._context is None or (full.width, full.height) != (
            self._context.width,
            self._context.height,
        ):
            self._context = self._opened(full)
        full.pts, full.pict_type = None, 0
        (packet,) = self._context.encode(full)
        return bytes(packet)

    def _opened(self, frame: Any) -> Any:
        context: Any = av.CodecContext.create("mjpeg", "w")
        context.width, context.height, context.pix_fmt = frame.width, frame.height, "yuvj420p"
        context.thread_count = 1
        context.color_range = 2
        context.qmin = context.qmax = JPEG_QUANTISER
        return context


def main(read: Callable[[str, NewestFrame], None]) -> None:
    """Run the process; `read` gets the line on its standard input."""
    step_back()
    av.logging.set_level(av.logging.PANIC)
    request = sys.stdin.buffer.readline().decode().strip()
    with suppress(BrokenPipeError):
        serve(partial(read, request), private_output())


def serve(read: Callable[[NewestFrame], None], output: BinaryIO) -> None:
    """Write the newest frame each time the one before is taken, and at the end why there are no more.

    `read` puts frames in a thread of its own, and ends them.
    """
    newest, maker = NewestFrame(), JpegMaker()
    threading.Thread(target=read, args=(newest,), daemon=True).start()
    try:
        while True:
            frame = newest.next()
            jpeg = maker.jpeg(frame.content)
            if len(jpeg) <= MAX_FRAME_BYTES:
                times = (frame.is_stamped, frame.timestamp_s, frame.arrived_s)
                write(output, FRAME_HEADER.pack(FRAME, *times) + jpeg)
    except (CameraFailedError, av.FFmpegError, MemoryError, ValueError) as error:
        write(output, FRAME_HEADER.pack(REASON, False, 0.0, 0.0) + reason_of(error).encode())


def write(output: BinaryIO, message: bytes) -> None:
    """Write one message after its length."""
    output.write(framed(message))
    output.flush()
