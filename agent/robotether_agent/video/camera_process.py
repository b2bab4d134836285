"""Reads an RTSP or V4L2 camera: `python -m robotether_agent.video.camera_process`, its URL on stdin, JPEGs on stdout.

Started by video.sources, one for an open camera. The URL may contain a login and stands in no message. Decodes
all frames and makes a JPEG of the newest alone; what falls behind the camera ends it, so that no frame is old.
"""

from __future__ import annotations

import logging
import re
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from math import inf
from typing import Any
from urllib.parse import urlsplit

import av
from robotether_common.frames import MAX_SIDE

from robotether_agent.clock import robot_time
from robotether_agent.video.av_program import LOW_DELAY_FLAG
from robotether_agent.video.newest_jpegs import (
    CameraFailedError,
    DecodedFrame,
    NewestFrame,
    decoded,
    main,
    reason_of,
)
from robotether_agent.video.timestamps import MAX_LAG_S

# Time limits for opening a camera, and for its next frame.
OPEN_S, READ_S = 10.0, 10.0
# Time for which a packet is waited for that was not there yet, and the maximum part by which the camera's clock may
# differ from this robot's: many count the frames, and call 24.97 a second 25.
WAITED_S, MAX_DRIFT = 0.005, 0.002
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
# Maximum number of frames that a decoder holds back (ITU-T H.264, A.3).
MAX_IN_DECODER = 16
# What FFmpeg's log says before it follows a redirect, which no option of its forbids.
REDIRECTS = "Redirecting to "
# Webcams leave them out, and browsers need them: such a frame is decoded like any other.
HUFFMAN_TABLES = b"\xff\xc4"


class RedirectRefusal(logging.Handler):
    """Stops the thread that reads before FFmpeg follows a redirect to another host, which may be inside a network."""

    def __init__(self, url: str, newest: NewestFrame) -> None:
        super().__init__()
        host = urlsplit(url).hostname or ""
        name = re.escape(f"[{host}]" if ":" in host else host)
        # All up to the path, and no long login: a line of the log ends after 1023 bytes, which may be before the host.
        self._same = re.compile(
            rf"rtsp://([^/?#@]{{,100}}@)?{name}(:[0-9]{{1,5}})?(/|$)", re.IGNORECASE
        )
        self._newest = newest

    def emit(self, record: logging.LogRecord) -> None:
        """Let FFmpeg go on, or not."""
        _, redirects, target = record.getMessage().partition(REDIRECTS)
        if redirects and not self._same.match(target.strip()):
            self._newest.end(CameraFailedError("it redirects to another host"))
            # For ever: FFmpeg connects when this returns.
            threading.Event().wait()


def refuse_redirects(url: str, newest: NewestFrame) -> None:
    """Have FFmpeg's log read, which is written in the thread that reads the camera."""
    logger = logging.getLogger("libav")
    logger.setLevel(logging.INFO)
    logger.propagate = False
    logger.handlers = [RedirectRefusal(url, newest)]
    av.logging.set_skip_repeated(False)
    av.logging.set_level(av.logging.INFO)


def read(url: str, newest: NewestFrame) -> None:
    """Read a camera until it ends, and say why it did."""
    try:
        refuse_redirects(url, newest)
        with opened(url) as container:
            for frame in frames_of(container):
                newest.put(frame)
        newest.end(CameraFailedError("it ended the stream"))
    except (CameraFailedError, av.FFmpegError, MemoryError, ValueError, IndexError) as error:
        newest.end(CameraFailedError(reason_of(error)))


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
    if not container.streams.video:
        raise CameraFailedError("it has no video")
    stream = container.streams.video[0]
    context = stream.codec_context
    context.thread_count = 1
    context.flags |= LOW_DELAY_FLAG
    context.options = {"max_pixels": str(MAX_SIDE * MAX_SIDE)}
    lag, arrivals = Lag(), Arrivals()
    for packet, waited_s in timed(container.demux(stream)):
        arrived_s = robot_time()
        if packet.pts is not None:
            timestamp_s = float(packet.pts * stream.time_base)
            lag.check(time.monotonic(), timestamp_s, keeps_up=waited_s > WAITED_S)
        if context.name == "mjpeg" and HUFFMAN_TABLES in (jpeg := bytes(packet)):
            yield DecodedFrame(jpeg, arrived_s, arrived_s)
            continue
        arrivals.add(packet.pts, arrived_s)
        for frame in decoded(context, packet):
            taken_s = arrivals.pop(frame.pts, arrived_s)
            yield DecodedFrame(frame, taken_s, taken_s)


def timed(packets: Iterator[Any]) -> Iterator[tuple[Any, float]]:
    """Yield each packet, and how long it was waited for."""
    asked_s = time.monotonic()
    for packet in packets:
        yield packet, time.monotonic() - asked_s
        asked_s = time.monotonic()


class Arrivals:
    """When frames came that are still in the decoder, as with B frames: each was taken before a later one came."""

    def __init__(self) -> None:
        self._by_pts: dict[int, float] = {}

    def add(self, pts: int | None, arrived_s: float) -> None:
        """Note that a packet came."""
        if pts is not None:
            self._by_pts[pts] = arrived_s
        if len(self._by_pts) > MAX_IN_DECODER:
            del self._by_pts[next(iter(self._by_pts))]

    def pop(self, pts: int | None, now_s: float) -> float:
        """Return when a frame, or a later one, came first; `now_s` where that is not known."""
        if pts is None:
            return now_s
        taken_s = min((at_s for each, at_s in self._by_pts.items() if each >= pts), default=now_s)
        self._by_pts = {each: at_s for each, at_s in self._by_pts.items() if each > pts}
        return taken_s


class Lag:
    """How much later than the quickest one a frame comes."""

    def __init__(self) -> None:
        self._least_s = inf
        self._now_s = 0.0

    def check(self, now_s: float, timestamp_s: float, *, keeps_up: bool) -> None:
        """Raise CameraFailedError where frames queue on the way; while none waits, clocks may drift apart."""
        late_s = now_s - timestamp_s
        if keeps_up:
            self._least_s += MAX_DRIFT * (now_s - self._now_s)
        self._least_s, self._now_s = min(self._least_s, late_s), now_s
        if late_s - self._least_s > MAX_LAG_S:
            raise CameraFailedError("this robot does not decode it as fast as it comes")


if __name__ == "__main__":
    main(read)
