"""How many bits codecs need for the PSNR of JPEG, and what encoding costs a robot. Used by `bench`; needs no demo."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from clips import CLIPS, FPS, SIZES, Clip, RawFrame, Size
from numpy.typing import NDArray
from paper.costs import trees_cpu_s
from report import Row, Section
from robotether_agent.video.av_process import av_process
from robotether_agent.video.encoder import COMMAND
from robotether_agent.video.encoder_messages import (
    MAX_ANSWER_BYTES,
    PRESETS,
    EncodeRequest,
    unpacked_answer,
)
from robotether_common.codecs import H264, VP8, Codec
from video_clips import Decoder, jpeg_of, pixels_of

SECONDS = 5.0
# Quality whose PSNR is the measure, and that of the camera's JPEGs.
MEASURE, CAMERA = 50, 95
# Least part of the JPEGs' bits that is tried, and number of rates from there up to all of them.
LEAST_PART, RATES = 1 / 40, 8
AIM_PARTS = {"easy": 1 / 4, "slow": 1 / 3, "fast": 1 / 1.7}
AIM_PERCENT = 6
LUMA = np.array([0.299, 0.587, 0.114], np.float32)


@dataclass(frozen=True)
class Coding:
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


def make_footage(clip: Clip, size: Size, count: int) -> Footage:
    raw, camera, total, errors = [], [], 0, []
    for frame in clip.frames(size, count):
        raw.append(frame @ LUMA)
        camera.append(jpeg_of(frame, CAMERA))
        measure = jpeg_of(frame, MEASURE)
        total += len(measure)
        errors.append(error_of(pixels_of(measure), raw[-1]))
    point = RatePoint(total * 8 * FPS / count, float(np.mean(errors)))
    return Footage(clip, size, raw, camera, point)


def error_of(decoded: RawFrame, raw_luma: NDArray[np.float32]) -> float:
    return float(np.mean((decoded @ LUMA - raw_luma) ** 2))


async def encoded(footage: Footage, coding: Coding, bits_per_s: float) -> RatePoint:
    """Encode all frames at one rate, one after the other, and decode them."""
    decoder, total, errors = Decoder(coding.codec.name), 0, []
    async with av_process(COMMAND) as process:
        # Empty: it has started.
        await process.message(MAX_ANSWER_BYTES)
        [started_cpu_s] = trees_cpu_s([process._process.pid])
        for jpeg, raw_luma in zip(footage.camera, footage.raw, strict=True):
            how = (coding.codec, *footage.size, bits_per_s, FPS, coding.preset)
            request = EncodeRequest(jpeg, *how, allows_hardware=False)
            await process.send(request.packed())
            unit = unpacked_answer(await process.message(MAX_ANSWER_BYTES)).data
            total += len(unit)
            errors.append(error_of(decoder.decode(unit), raw_luma))
        cpu_s = trees_cpu_s([process._process.pid])[0] - started_cpu_s
    count = len(footage.raw)
    return RatePoint(total * 8 * FPS / count, float(np.mean(errors)), cpu_s / count)


def rows_of(footage: Footage) -> Iterator[Row]:
    """JPEG's row, and one of each codec; one without figures for a codec that needs more bits than JPEG."""
    yield row(footage, "JPEG, quality 50", footage.jpeg)
    for coding in CODINGS:
        rates = np.geomspace(LEAST_PART, 1, RATES) * footage.jpeg.bits_per_s
        made = [asyncio.run(encoded(footage, coding, float(rate))) for rate in rates]
        points = sorted(made, key=lambda point: point.psnr_db)
        levels, goal = [point.psnr_db for point in points], footage.jpeg.psnr_db
        # Between two rates the logarithm of bits grows evenly with the PSNR.
        bits = np.exp(np.interp(goal, levels, np.log([point.bits_per_s for point in points])))
        taken_s = [point.cpu_s_a_frame for point in points if point.cpu_s_a_frame is not None]
        cpu_s = np.interp(goal, levels, taken_s)
        found = RatePoint(float(bits), footage.jpeg.error, float(cpu_s))
        name = f"{coding.codec.name}, {coding.preset}"
        yield row(footage, name, found if levels[0] <= goal <= levels[-1] else None)


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
    count = round(seconds * FPS)
    rows = [
        row for size in sizes for clip in CLIPS for row in rows_of(make_footage(clip, size, count))
    ]
    text = (
        f"Clips of {seconds:g} s at {FPS} frames a second, drawn by a seed: a camera that stands, with a thing that "
        "moves (easy), one that pans slowly (slow), and one that turns fast in poor light (fast). A turn only shifts "
        "what is seen, without perspective or blur: codecs predict that better than what most cameras see. The "
        f"camera gives JPEGs of quality {CAMERA}. The agent's encoder process makes H.264 and VP8 of them, without "
        f"hardware, at {RATES} rates; between two of them is that at which luma's PSNR against the raw frames is that "
        f"of JPEG at quality {MEASURE}. Bits include the key frame at the start. Encoding is the process's processor "
        "time, with the decoding of the camera's JPEGs.\n\n"
        f"Aim: the bits in the column of that name, and {AIM_PERCENT} % of a core at 640x480."
    )
    return Section("Bits of codecs at the same PSNR, and the cost of encoding", text, rows)
