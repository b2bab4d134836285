"""How many bits codecs need for the PSNR of JPEG, and what encoding costs a robot. Used by `bench`; needs no demo."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
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

# Rows, columns, and the colours red, green and blue, 0 to 255.
RawFrame = NDArray[np.uint8]
Size = tuple[int, int]
Values = NDArray[np.float32]

FPS = 15
SIZES: tuple[Size, ...] = ((640, 480), (1280, 720))
SEED = 36
# Of the scene: radii are parts of its height; the grain is a standard deviation of levels.
LEAVES, LEAST_RADIUS, MOST_RADIUS = 500, 0.015, 0.3
GRAIN, GRAIN_FALLS = 6.0, 1.2
# Of the small thing that moves before the camera that stands: parts of the frame's height.
THING_RADIUS, THING_PATH = 0.06, 0.3
THING_EVERY_S = 4.0
THING = np.array([220, 60, 40], np.float32)


@dataclass(frozen=True)
class Clip:
    """How the camera turns, in widths of its frame a second, and its noise, a standard deviation of levels."""

    name: str
    turn_per_s: float
    noise: float
    has_thing: bool = False

    def frames(self, size: Size, count: int) -> Iterator[RawFrame]:
        width, height = size
        whole, random = scene(size), np.random.default_rng(SEED)
        for number in range(count):
            frame = turned(whole, self.turn_per_s * width * number / FPS)[:, :width].copy()
            if self.has_thing:
                angle = 2 * np.pi * number / FPS / THING_EVERY_S
                row = height * (0.5 + THING_PATH * np.sin(angle) / 2)
                column = width / 2 + height * THING_PATH * np.cos(angle)
                put_disc(frame, row, column, THING_RADIUS * height, THING)
            noise = random.standard_normal(frame.shape, dtype=np.float32) * self.noise
            yield np.clip(frame + noise + 0.5, 0, 255).astype(np.uint8)


CLIPS = (
    Clip("easy", turn_per_s=0.0, noise=2.0, has_thing=True),
    Clip("slow", turn_per_s=0.06, noise=2.0),
    Clip("fast", turn_per_s=0.9, noise=5.0),
)


@lru_cache(maxsize=1)
def scene(size: Size) -> Values:
    """Draw what is around the camera, two frames wide; its right end goes on with its left one."""
    width, height = 2 * size[0], size[1]
    random = np.random.default_rng(SEED)
    image = np.full((height, width, 3), 128, np.float32)
    # The density of a radius falls with its third power, so that leaves of each scale cover as much.
    parts = random.uniform((LEAST_RADIUS / MOST_RADIUS) ** 2, 1, LEAVES)
    for radius in LEAST_RADIUS * height / np.sqrt(parts):
        row, column = random.uniform(0, height), random.uniform(0, width)
        colour = (random.uniform(40, 215) + random.normal(0, 15, 3)).astype(np.float32)
        put_disc(image, row, column, radius, colour)
    return image + grain(random, (height, width))[:, :, None]


def put_disc(image: Values, row: float, column: float, radius: float, colour: Values) -> None:
    """Fill a disc; what is beyond the right end is at the left one."""
    rows = np.arange(max(0, int(row - radius)), min(len(image), int(row + radius) + 2))[:, None]
    columns = np.arange(int(column - radius), int(column + radius) + 2)[None, :]
    inside = np.nonzero((rows - row) ** 2 + (columns - column) ** 2 < radius**2)
    image[rows[inside[0], 0], columns[0, inside[1]] % image.shape[1]] = colour


def grain(random: np.random.Generator, shape: tuple[int, int]) -> Values:
    spectrum = np.fft.rfft2(random.standard_normal(shape))
    down, across = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :]
    frequency = np.hypot(down, across)
    frequency[0, 0] = np.inf
    texture = np.fft.irfft2(spectrum / frequency**GRAIN_FALLS, shape)
    return (texture / texture.std() * GRAIN).astype(np.float32)


def turned(whole: Values, pixels: float) -> Values:
    """Turn the scene to the left; what is between two pixels is the mean of both by their distance."""
    steps, part = int(pixels // 1), pixels % 1
    left = np.roll(whole, -steps, axis=1)
    return left if part == 0 else left * (1 - part) + np.roll(left, -1, axis=1) * part


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
