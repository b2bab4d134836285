"""Reads an RTSP or V4L2 camera: `python -m robotether_agent.video.camera_process`, its URL on stdin, JPEGs on stdout.

Started by video.sources, one for an open camera. The URL may contain a login and stands in no message. Decodes
all frames and makes a JPEG of the newest alone; what falls behind the camera ends it, so that no frame is old.
"""

from __future__ import annotations

import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, BinaryIO

import av
from robotether_common.frames import MAX_FRAME_BYTES, MAX_SIDE

from robotether_agent.clock import robot_time
from robotether_agent.problems import DetailError
from robotether_agent.video.av_messages import FRAME, FRAME_HEADER, REASON, framed
from robotether_agent.video.av_program import private_output, step_back

# Time limits for opening a camera, and for its next frame.
OPEN_S, READ_S = 10.0, 10.0
# Time limit by which frames may come later than the first did: more is a queue on the way.
MAX_LAG_S = 1.0
# Default quantiser of JPEGs, of 2 (best) to 31: about quality 90.
JPEG_QUANTISER = 3
RTSP_OPTIONS = {
    # No redirect or description leads to a file, or to another protocol.
    "protocol_whitelist": "rtsp,rtp,rtcp,udp,tcp",
    "rtsp_transport": "tcp",
    "timeout": str(int(READ_S * 1e6)),
    "fflags": "nobuffer",
    "flags": "low_delay",
    "max_delay": "0",
    "analyzeduration": "1000000",
    "probesize": "500000",
}
LOW_DELAY_FLAG = 0x80000
# Webcams leave them out, and browsers need them: such a frame is decoded like any other.
HUFFMAN_TABLES = b"\xff\xc4"


class CameraFailedError(DetailError):
    """The camera gives no frames; the message says why, without its URL."""


@dataclass(frozen=True)
class DecodedFrame:
    """A frame and its arrival on the robot's clock; `content` is a JPEG already, or PyAV's frame."""

    content: Any
    arrived_s: float


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


def read(url: str, newest: NewestFrame) -> None:
    """Read a camera until it ends, and say why it did."""
    try:
        with opened(url) as container:
            for frame in frames_of(container):
                newest.put(frame)
        newest.end(CameraFailedError("it ended the stream"))
    except CameraFailedError as error:
        newest.end(error)
    except (av.FFmpegError, MemoryError, ValueError, IndexError) as error:
        # Not the error's own text, which has the URL.
        newest.end(CameraFailedError(getattr(error, "strerror", None) or type(error).__name__))


def opened(url: str) -> Any:
    """Return PyAV's container of an RTSP URL or a device."""
    timeout = (OPEN_S, READ_S)
    if url.startswith("rtsp://"):
        return av.open(url, options=RTSP_OPTIONS, timeout=timeout)
    with suppress(av.FFmpegError):
        return av.open(url, format="v4l2", options={"input_format": "mjpeg"}, timeout=timeout)
    # It makes no JPEGs.
    return av.open(url, format="v4l2", timeout=timeout)


def frames_of(container: Any) -> Any:
    """Yield each frame of a camera's video as soon as it is there."""
    stream = container.streams.video[0]
    context = stream.codec_context
    context.thread_count = 1
    context.flags |= LOW_DELAY_FLAG
    context.options = {"max_pixels": str(MAX_SIDE * MAX_SIDE)}
    lag = Lag()
    for packet in container.demux(stream):
        arrived_s = robot_time()
        if packet.pts is not None:
            lag.check(time.monotonic(), float(packet.pts * stream.time_base))
        if context.name == "mjpeg" and HUFFMAN_TABLES in (jpeg := bytes(packet)):
            yield DecodedFrame(jpeg, arrived_s)
            continue
        for frame in context.decode(packet):
            yield DecodedFrame(frame, arrived_s)


class Lag:
    """How much later than the quickest one a frame comes."""

    def __init__(self) -> None:
        self._least_s: float | None = None

    def check(self, now_s: float, timestamp_s: float) -> None:
        """Raise CameraFailedError where frames queue on the way."""
        late_s = now_s - timestamp_s
        if self._least_s is None or late_s < self._least_s:
            self._least_s = late_s
        if late_s - self._least_s > MAX_LAG_S:
            raise CameraFailedError("this robot does not decode it as fast as it comes")


class JpegMaker:
    """Makes a JPEG of a decoded frame."""

    def __init__(self) -> None:
        self._context: Any = None

    def jpeg(self, frame: Any) -> bytes:
        """Return a frame as a JPEG of its own size."""
        if isinstance(frame, bytes):
            return frame
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


def serve(url: str, output: BinaryIO) -> None:
    """Write the newest frame each time the one before is taken, and at the end why there are no more."""
    newest, maker = NewestFrame(), JpegMaker()
    threading.Thread(target=read, args=(url, newest), daemon=True).start()
    try:
        while True:
            frame = newest.next()
            jpeg = maker.jpeg(frame.content)
            if len(jpeg) <= MAX_FRAME_BYTES:
                write(output, FRAME_HEADER.pack(FRAME, frame.arrived_s) + jpeg)
    except (CameraFailedError, av.FFmpegError, MemoryError, ValueError) as error:
        reason = str(error) if isinstance(error, CameraFailedError) else type(error).__name__
        write(output, FRAME_HEADER.pack(REASON, 0.0) + reason.encode())


def write(output: BinaryIO, message: bytes) -> None:
    """Write one message after its length."""
    output.write(framed(message))
    output.flush()


def main() -> int:
    """Run the process."""
    step_back()
    av.logging.set_level(av.logging.PANIC)
    url = sys.stdin.buffer.readline().decode().strip()
    with suppress(BrokenPipeError):
        serve(url, private_output())
    return 0


if __name__ == "__main__":
    sys.exit(main())
