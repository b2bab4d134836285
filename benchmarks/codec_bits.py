"""How many bits codecs need for the PSNR of JPEG, and what encoding costs a robot, on the clips of clips.py.

The camera gives JPEGs of web_video_server's default quality, and the agent's own encoder process makes access units of
them. Its rate is searched for until the decoded frames are as near to the raw ones as JPEGs of quality 50 are. Used by
`bench`; needs neither a demo nor root. Processor time is the encoder process's own, with the decoding of the camera's
JPEGs.
"""

from __future__ import annotations

import io
import subprocess
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import IO, Self

import numpy as np
from clips import CLIPS, FPS, SIZES, Clip, RawFrame, Size, jpeg_of
from numpy.typing import NDArray
from paper.costs import trees_cpu_s
from paper.programs import our_environment
from PIL import Image
from report import Row, Section
from robotether_agent.video.av_messages import LENGTH
from robotether_agent.video.encoder import COMMAND
from robotether_agent.video.encoder_messages import (
    PRESETS,
    EncodedFrame,
    EncodeRequest,
    unpacked_answer,
)
from robotether_common.codecs import H264, VP8, Codec
from video_clips import Decoder

SECONDS = 5.0
# Quality whose PSNR is the measure, and that of the camera's JPEGs.
MEASURE, CAMERA = 50, 95
# Parts of the JPEGs' bits between which the rate is searched, and the number of steps of the search.
LEAST_PART, STEPS = 1 / 40, 6
AIM_PARTS = {"easy": 1 / 4, "slow": 1 / 3, "fast": 1 / 1.7}
AIM_PERCENT = 6
LUMA = np.array([0.299, 0.587, 0.114], np.float32)


@dataclass(frozen=True)
class Coding:
    """A codec, and how much work its encoder may put into it."""

    codec: Codec
    preset: str


CODINGS = (Coding(H264, PRESETS[0]), Coding(H264, PRESETS[-1]), Coding(VP8, PRESETS[0]))


@dataclass(frozen=True)
class RatePoint:
    """What a codec made of all frames at one rate; errors are the mean square ones of luma."""

    bits_per_s: float
    error: float
    cpu_s_a_frame: float | None = None

    @property
    def psnr_db(self) -> float:
        return float(10 * np.log10(255**2 / self.error))


@dataclass(frozen=True)
class Footage:
    """A clip's raw frames, as luma, and as the camera gives them."""

    clip: Clip
    size: Size
    raw: Sequence[NDArray[np.float32]]
    camera: Sequence[bytes]
    # The same frames as JPEGs of quality MEASURE.
    jpeg: RatePoint


class EncoderProcess:
    """The agent's encoder process, asked for one frame after the other."""

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(
            COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=our_environment()
        )
        # Empty: it has started.
        self._message()
        self._started_cpu_s = self._cpu_s()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.kill()
        self._process.communicate()

    def encode(self, request: EncodeRequest) -> EncodedFrame:
        stdin = self._process.stdin
        assert stdin is not None
        stdin.write(request.packed())
        stdin.flush()
        return unpacked_answer(self._message())

    def used_cpu_s(self) -> float:
        """Return its processor time without that of its start."""
        return self._cpu_s() - self._started_cpu_s

    def _cpu_s(self) -> float:
        return trees_cpu_s([self._process.pid])[0]

    def _message(self) -> bytes:
        stdout = self._process.stdout
        assert stdout is not None
        (length,) = LENGTH.unpack(_exactly(stdout, LENGTH.size))
        return _exactly(stdout, length)


def _exactly(stream: IO[bytes], size: int) -> bytes:
    data = stream.read(size)
    if len(data) < size:
        raise RuntimeError("cannot measure codecs: the encoder process ended")
    return data


def make_footage(clip: Clip, size: Size, count: int) -> Footage:
    """Draw a clip, and encode it as the camera does and as JPEGs of quality MEASURE."""
    raw, camera, total, errors = [], [], 0, []
    for frame in clip.frames(size, count):
        raw.append(frame @ LUMA)
        camera.append(jpeg_of(frame, CAMERA))
        measure = jpeg_of(frame, MEASURE)
        total += len(measure)
        with Image.open(io.BytesIO(measure)) as opened:
            errors.append(error_of(np.asarray(opened), raw[-1]))
    point = RatePoint(total * 8 * FPS / count, float(np.mean(errors)))
    return Footage(clip, size, raw, camera, point)


def error_of(decoded: RawFrame, raw_luma: NDArray[np.float32]) -> float:
    return float(np.mean((decoded @ LUMA - raw_luma) ** 2))


def encoded(footage: Footage, coding: Coding, bits_per_s: float) -> RatePoint:
    """Encode all frames at one rate, and decode them."""
    decoder, total, errors = Decoder(coding.codec.name), 0, []
    with EncoderProcess() as process:
        for jpeg, raw_luma in zip(footage.camera, footage.raw, strict=True):
            request = EncodeRequest(
                jpeg,
                coding.codec,
                *footage.size,
                bits_per_s,
                FPS,
                coding.preset,
                allows_hardware=False,
            )
            unit = process.encode(request).data
            total += len(unit)
            errors.append(error_of(decoder.decode(unit), raw_luma))
        cpu_s = process.used_cpu_s()
    count = len(footage.raw)
    return RatePoint(total * 8 * FPS / count, float(np.mean(errors)), cpu_s / count)


def bits_at(
    psnr_db: float, highest_bits_per_s: float, measure: Callable[[float], RatePoint]
) -> RatePoint | None:
    """Return what a codec needs for this PSNR, None if it needs more than the highest rate.

    Halves the range of rates on a logarithmic scale; between the last two, bits grow evenly with the PSNR.
    """
    low, high = measure(highest_bits_per_s * LEAST_PART), measure(highest_bits_per_s)
    if high.psnr_db < psnr_db:
        return None
    low_rate, high_rate = highest_bits_per_s * LEAST_PART, highest_bits_per_s
    for _ in range(STEPS):
        middle_rate = float(np.sqrt(low_rate * high_rate))
        middle = measure(middle_rate)
        if middle.psnr_db < psnr_db:
            low, low_rate = middle, middle_rate
        else:
            high, high_rate = middle, middle_rate
    levels = (low.psnr_db, high.psnr_db)
    bits = np.interp(psnr_db, levels, np.log([low.bits_per_s, high.bits_per_s]))
    error = 255**2 / 10 ** (float(np.clip(psnr_db, *levels)) / 10)
    return RatePoint(float(np.exp(bits)), error, high.cpu_s_a_frame)


def rows_of(footage: Footage) -> Iterator[Row]:
    """JPEG's row, and one of each codec."""
    yield row(footage, "JPEG, quality 50", footage.jpeg)
    for coding in CODINGS:
        point = bits_at(
            footage.jpeg.psnr_db, footage.jpeg.bits_per_s, partial(encoded, footage, coding)
        )
        yield row(footage, f"{coding.codec.name}, {coding.preset}", point)


def row(footage: Footage, codec: str, point: RatePoint | None) -> Row:
    columns = {"clip": footage.clip.name, "size": "x".join(map(str, footage.size)), "codec": codec}
    if point is None:
        return columns
    cpu_s = point.cpu_s_a_frame
    return {
        **columns,
        "PSNR, dB": f"{point.psnr_db:.1f}",
        "kbit/s": point.bits_per_s / 1000,
        "of JPEG's bits": point.bits_per_s / footage.jpeg.bits_per_s,
        "aim": AIM_PARTS[footage.clip.name] if cpu_s else None,
        "encoding, ms a frame": cpu_s and cpu_s * 1000,
        f"% of a core at {FPS}/s": cpu_s and cpu_s * FPS * 100,
    }


def measure(seconds: float = SECONDS, sizes: Sequence[Size] = SIZES) -> Section:
    """Measure all clips, one after the other."""
    count = round(seconds * FPS)
    rows = [
        row for size in sizes for clip in CLIPS for row in rows_of(make_footage(clip, size, count))
    ]
    text = (
        f"Clips of {seconds:g} s at {FPS} frames a second, drawn by a seed: a camera that stands, with a thing that "
        "moves (easy), one that pans slowly (slow), and one that turns fast in poor light (fast). A turn only shifts "
        "what is seen, without perspective or blur: codecs predict that better than what most cameras see. The "
        f"camera gives JPEGs of quality {CAMERA}. The agent's encoder process makes H.264 and VP8 of them, without "
        "hardware; their rate is searched for until luma's PSNR against the raw frames is that of JPEG at quality "
        f"{MEASURE}. Bits include the key frame at the start. Encoding is the process's processor time, with the "
        "decoding of the camera's JPEGs.\n\n"
        f"Aim: the bits in the column of that name, and {AIM_PERCENT} % of a core at 640x480."
    )
    return Section("Bits of codecs at the same PSNR, and the cost of encoding", text, rows)
