"""Encodes a camera's frames: `python -m robotether_agent.video.encoder_process`, requests on stdin, answers on stdout.

Started by video.encoder, one for a camera. It ends with its standard input, or with the agent. A frame that it cannot
encode does not end it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any, BinaryIO

import av
from av.video.frame import PictureType
from robotether_common.codecs import H264, VP8, Codec
from robotether_common.frames import MAX_DEPENDENT_FRAME_BYTES, MAX_SIDE

from robotether_agent.video.av_messages import LENGTH, framed
from robotether_agent.video.av_program import (
    FULL,
    LIMITED,
    LOW_DELAY_FLAG,
    private_output,
    step_back,
)
from robotether_agent.video.encoder_messages import (
    MAX_REQUEST_BYTES,
    PRESETS,
    EncodedFrame,
    EncodeRequest,
    FrameRefusedError,
    refusal,
)
from robotether_agent.video.newest_jpegs import reason_of

# Part of the rate that an encoder was opened with to which it may fall on the open one: a step of the quality and back.
# The bound of one frame's bits stays, since PyAV does not change it; so a lower rate needs a new encoder.
MIN_PART = 0.65
# Number of frames between key frames that nobody requests.
KEY_FRAME_INTERVAL = 1_000_000
# Minimum quantiser, on each codec's own scale: no bits for what the camera's own JPEG does not have.
MIN_QUANTISERS: dict[Codec, int] = {H264: 20, VP8: 8}
# Number of frames whose bits one frame may have, below and from NARROW_BITS_PER_S on.
NARROW_BITS_PER_S = 5_000_000
NARROW_BUFFER, WIDE_BUFFER = 2, 4
# Maximum size of VP8's key frames in percent of a frame's.
VP8_KEY_PERCENT = 300
# Number of the NAL unit SPS in Annex B, with which a key frame begins that can be decoded by itself.
SPS = 7
# Number of BT.601, which goes in limited range, as decoders expect it of video and as JPEG's own matrix is.
BT601 = 6
# Darkest and brightest value of a trial's picture, and the maximum difference of a sample once it was encoded.
DARK, BRIGHT, MAX_DIFFERENCE = 16, 235, 64
# Number of samples of a trial's picture in each direction, and the minimum of its bits a pixel: with few all look bad.
SAMPLES, TRIAL_BITS = 16, 0.05


@dataclass(frozen=True)
class EncoderKind:
    """One of FFmpeg's encoders, and its options beside the bounds of its bits: no delay, no key frame by itself."""

    name: str
    codec: Codec
    is_hardware: bool = False
    # Whether it follows `bit_rate` while it is open.
    follows_rate: bool = False
    # Whether its bounds are kept only with a minimum rate, too.
    has_minimum_rate: bool = False
    pixel_format: str = "yuv420p"
    options: Mapping[str, str] = field(default_factory=dict)
    # The option that a preset of ours is, and what it is called there; hardware has one for all.
    preset_option: str = ""
    presets: Sequence[str] = PRESETS

    def options_for(self, request: EncodeRequest) -> dict[str, str]:
        """Return FFmpeg's options for a request; one frame's bits are bounded."""
        rate = request.bits_per_s
        frames = NARROW_BUFFER if rate < NARROW_BITS_PER_S else WIDE_BUFFER
        options = {
            # Not above the rate: x264 would no longer follow another one.
            "maxrate": str(int(rate)),
            "bufsize": str(max(1000, int(frames * rate / request.fps))),
            **self.options,
        }
        if self.has_minimum_rate:
            options["minrate"] = options["maxrate"]
        if self.preset_option:
            options[self.preset_option] = self.presets[PRESETS.index(request.preset)]
        return options


# In the order in which they are tried; the last of a codec is the one in software.
ENCODERS = (
    EncoderKind("h264_v4l2m2m", H264, is_hardware=True),
    EncoderKind(
        "h264_nvenc",
        H264,
        is_hardware=True,
        follows_rate=True,
        options={
            "preset": "p2",
            "tune": "ull",
            "zerolatency": "1",
            "delay": "0",
            "forced-idr": "1",
            "profile": "main",
            "rc": "cbr",
        },
    ),
    EncoderKind(
        "h264_qsv",
        H264,
        is_hardware=True,
        follows_rate=True,
        pixel_format="nv12",
        options={
            "preset": "veryfast",
            "async_depth": "1",
            "low_delay_brc": "1",
            "forced_idr": "1",
            "profile": "main",
        },
    ),
    EncoderKind(
        "libx264",
        H264,
        follows_rate=True,
        # Constant frame durations: a frame has its bits, however many are skipped between.
        options={
            "tune": "zerolatency",
            "profile": "main",
            "forced-idr": "1",
            "x264-params": "repeat-headers=1:annexb=1:scenecut=0:keyint=infinite",
        },
        preset_option="preset",
    ),
    EncoderKind(
        "libvpx",
        VP8,
        has_minimum_rate=True,
        options={
            "deadline": "realtime",
            "lag-in-frames": "0",
            "max-intra-rate": str(VP8_KEY_PERCENT),
        },
        preset_option="cpu-used",
        presets=("6", "8", "12"),
    ),
)


class OpenEncoder:
    """An encoder that is opened for a size, rate and preset."""

    def __init__(self, kind: EncoderKind, request: EncodeRequest) -> None:
        self.kind = kind
        self._request = request
        self._number = 0
        context: Any = av.CodecContext.create(kind.name, "w")
        context.width, context.height = request.width, request.height
        context.pix_fmt = kind.pixel_format
        context.time_base = Fraction(1, 1000)
        context.framerate = Fraction(request.fps).limit_denominator(1000)
        context.bit_rate = int(request.bits_per_s)
        context.gop_size = KEY_FRAME_INTERVAL
        context.max_b_frames = 0
        context.thread_count = 1
        context.color_range, context.colorspace = LIMITED, BT601
        context.color_primaries = context.color_trc = BT601
        context.qmin = MIN_QUANTISERS[request.codec]
        context.options = kind.options_for(request)
        self._context = context

    def fits(self, request: EncodeRequest) -> bool:
        """Whether it can encode the request's frame, after those before it."""
        mine = self._request
        part = request.bits_per_s / mine.bits_per_s
        return (
            (request.codec, request.width, request.height, request.fps)
            == (mine.codec, mine.width, mine.height, mine.fps)
            and (request.preset == mine.preset or not self.kind.preset_option)
            and (request.allows_hardware or not self.kind.is_hardware)
            and (part == 1 or (self.kind.follows_rate and MIN_PART <= part < 1))
        )

    def encode(self, frame: Any, request: EncodeRequest) -> tuple[bytes, bool]:
        """Return the frame as one access unit, and whether it is a key frame; FrameRefusedError if it is none."""
        scaled = frame.reformat(
            width=request.width,
            height=request.height,
            format=self._context.pix_fmt,
            src_color_range=FULL if frame.color_range != LIMITED else LIMITED,
            dst_color_range=LIMITED,
            interpolation="BILINEAR",
            threads=1,
        )
        scaled.pts = self._number * max(1, round(1000 / request.fps))
        scaled.time_base = self._context.time_base
        scaled.pict_type = PictureType.I if request.requests_key else PictureType.NONE
        self._number += 1
        self._context.bit_rate = int(request.bits_per_s)
        packets = self._context.encode(scaled)
        if len(packets) != 1:
            raise FrameRefusedError(f"{self.kind.name} made {len(packets)} packets of one frame")
        data = bytes(packets[0])
        if len(data) > MAX_DEPENDENT_FRAME_BYTES:
            raise FrameRefusedError(f"{self.kind.name} made a frame of {len(data)} bytes")
        return data, packets[0].is_keyframe


class FrameTranscoder:
    """JPEGs to access units, by an encoder that stays open while requests fit."""

    def __init__(self) -> None:
        self._decoder: Any = None
        self._encoder: OpenEncoder | None = None
        # Whether hardware passed its trial in a size, which costs three frames, and has failed at no frame since.
        self._is_fit: dict[tuple[str, int, int], bool] = {}

    def encode(self, request: EncodeRequest) -> EncodedFrame:
        """Return the request's frame; FrameRefusedError says why there is none."""
        began_s = time.perf_counter()
        frame = self._decoded(request.jpeg)
        try:
            encoder = self._encoder_for(request)
            data, is_key = encoder.encode(frame, request)
        except (FrameRefusedError, av.FFmpegError, MemoryError, ValueError) as error:
            # What it may have encoded nobody gets: the next frame begins a new sequence, of software.
            if self._encoder is not None:
                self._is_fit[_trial_of(self._encoder.kind, request)] = False
                self._encoder = None
            raise FrameRefusedError(f"the encoder failed: {reason_of(error)}") from error
        return EncodedFrame(data, is_key, encoder.kind.name, time.perf_counter() - began_s)

    def _decoded(self, jpeg: bytes) -> Any:
        if self._decoder is None:
            self._decoder = av.CodecContext.create("mjpeg", "r")
            self._decoder.thread_count = 1
            self._decoder.options = {"max_pixels": str(MAX_SIDE * MAX_SIDE)}
        try:
            (frame,) = self._decoder.decode(av.Packet(jpeg))
        except (av.FFmpegError, MemoryError, ValueError) as error:
            self._decoder = None
            raise FrameRefusedError(
                f"the camera's JPEG cannot be decoded: {reason_of(error)}"
            ) from error
        return frame

    def _encoder_for(self, request: EncodeRequest) -> OpenEncoder:
        if self._encoder is None or not self._encoder.fits(request):
            # The one before ends first, which frees its memory.
            self._encoder = None
            self._encoder = self._opened(request)
        return self._encoder

    def _opened(self, request: EncodeRequest) -> OpenEncoder:
        *hardware, software = (kind for kind in ENCODERS if kind.codec is request.codec)
        for kind in hardware if request.allows_hardware else ():
            trial = _trial_of(kind, request)
            if self._is_fit.get(trial, True):
                with suppress(av.FFmpegError, FrameRefusedError, ValueError, MemoryError):
                    if trial not in self._is_fit:
                        check_hardware(kind, request)
                    encoder = OpenEncoder(kind, request)
                    self._is_fit[trial] = True
                    return encoder
                self._is_fit[trial] = False
        return OpenEncoder(software, request)


def _trial_of(kind: EncoderKind, request: EncodeRequest) -> tuple[str, int, int]:
    """Return what hardware is tried for: drivers pad the rows of some widths, which FFmpeg does not look at."""
    return kind.name, request.width, request.height


def check_hardware(kind: EncoderKind, request: EncodeRequest) -> None:
    """Raise what speaks against an encoder.

    Each frame must come out at once and show what went in, and a key frame must come by request.
    """
    decoder: Any = av.CodecContext.create(request.codec.name, "r")
    decoder.thread_count = 1
    decoder.flags |= LOW_DELAY_FLAG
    bits_per_s = TRIAL_BITS * request.width * request.height * request.fps
    request = replace(request, bits_per_s=max(bits_per_s, request.bits_per_s))
    encoder, frame = OpenEncoder(kind, request), _trial_frame(request.width, request.height)
    expected = _samples(frame)
    for requests_key in (True, False, True):
        data, is_key = encoder.encode(frame, replace(request, requests_key=requests_key))
        if is_key != requests_key or (is_key and SPS not in nal_types(data)):
            raise FrameRefusedError(f"{kind.name} makes key frames of its own kind")
        (decoded,) = decoder.decode(av.Packet(data))
        difference = max(abs(a - b) for a, b in zip(expected, _samples(decoded), strict=True))
        if difference > MAX_DIFFERENCE:
            raise FrameRefusedError(f"{kind.name} makes another picture")


def _trial_frame(width: int, height: int) -> Any:
    """Return a picture in which rows of another length or place look different."""
    frame: Any = av.VideoFrame(width, height, "yuv420p")
    frame.color_range = LIMITED
    for number, plane in enumerate(frame.planes):
        row = bytes(DARK + (BRIGHT - DARK) * at // plane.width for at in range(plane.width))
        row = row[::-1] if number else row
        plane.update(row.ljust(plane.line_size, b"\0") * (plane.buffer_size // plane.line_size))
    return frame


def _samples(frame: Any) -> list[int]:
    """Return values of each plane, from its first row and column to its last."""
    samples = []
    for plane in frame.planes:
        data, parts = bytes(plane), range(SAMPLES + 1)
        rows, columns = (
            [(side - 1) * part // SAMPLES for part in parts] for side in (plane.height, plane.width)
        )
        samples += [data[row * plane.line_size + column] for row in rows for column in columns]
    return samples


def nal_types(data: bytes) -> set[int]:
    """Return the types of the NAL units of an access unit in Annex B."""
    return {part[0] & 31 for part in data.split(b"\x00\x00\x01")[1:] if part}


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer each request in turn, until there are no more."""
    transcoder = FrameTranscoder()
    # Nothing: it has started.
    answers.write(framed(b""))
    answers.flush()
    while head := requests.read(LENGTH.size):
        (length,) = LENGTH.unpack(head)
        if length > MAX_REQUEST_BYTES:
            return
        try:
            answer = transcoder.encode(EncodeRequest.unpacked(requests.read(length))).packed()
        except FrameRefusedError as refused:
            answer = refusal(str(refused))
        answers.write(answer)
        answers.flush()


def main() -> int:
    """Run the process."""
    step_back()
    av.logging.set_level(av.logging.PANIC)
    with suppress(BrokenPipeError):
        serve(sys.stdin.buffer, private_output())
    return 0


if __name__ == "__main__":
    sys.exit(main())
