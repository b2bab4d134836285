"""Makes the three clips that codecs are compared on: the same frames on every machine, by a seed.

A scene is of dead leaves, discs of all sizes that hide each other, with a grain that falls with its frequency: both are
the usual models of what cameras see. The camera stands (easy), pans slowly (slow) or turns fast (fast). Each frame has
a sensor's noise of its own, so that no codec can take it from the frame before.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

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
        """Give that many frames, FPS a second, of that width and height in pixels."""
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
