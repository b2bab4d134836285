"""Decodes the frames of one camera, which a robot wrote: their size is bounded, and what is damaged gives no frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import av
from av.video.frame import VideoFrame

from robotether_server.lerobot.recording import RecordedFrame

# Names of the decoders, by the codec as a recording has it.
DECODERS = {"jpeg": "mjpeg", "h264": "h264", "vp8": "vp8"}
# Maximum size of a frame: no more is allocated, whatever it says of itself.
MAX_PIXELS = 4096 * 2304
MIN_SIDE = 16


class CameraDecoder:
    """Decodes frames in their order, the place of each being its number among all of its camera."""

    def __init__(self) -> None:
        self._decoder: Any = None
        self._codec = ""
        # Of the newest frame that came, and of the newest that was decoded.
        self._place = self._decoded_place = -1

    def decode(self, frame: RecordedFrame) -> Iterator[tuple[int, VideoFrame]]:
        """Yield the frames that can be shown now, each with its place."""
        self._place += 1
        if frame.codec != self._codec:
            yield from self.flush()
            self._codec = frame.codec
        if frame.codec not in DECODERS or not frame.data:
            return
        if self._decoder is None:
            self._decoder = _decoder(frame.codec)
        packet = av.Packet(frame.data)
        packet.pts = packet.dts = self._place
        yield from self._decoded(packet)

    def flush(self) -> Iterator[tuple[int, VideoFrame]]:
        """Yield what is left; what comes next cannot depend on what came before."""
        if self._decoder is not None:
            yield from self._decoded(None)
            self._decoder = None

    def _decoded(self, packet: av.Packet[Any] | None) -> Iterator[tuple[int, VideoFrame]]:
        try:
            frames = self._decoder.decode(packet)
        except (av.FFmpegError, MemoryError, ValueError):
            # What depends on this frame cannot be decoded either: a new decoder waits for the next key frame.
            self._decoder = None
            return
        for frame in frames:
            # A stream in which frames come in another order than they are shown has none of ours.
            is_next = frame.pts is not None and frame.pts > self._decoded_place
            if is_next and not frame.is_corrupt and min(frame.width, frame.height) >= MIN_SIDE:
                self._decoded_place = frame.pts
                yield frame.pts, frame


def _decoder(codec: str) -> Any:
    decoder = av.CodecContext.create(DECODERS[codec], "r")
    decoder.options = {"max_pixels": str(MAX_PIXELS), "flags": "low_delay", "threads": "1"}
    return decoder
