"""Decides how a camera's frames are encoded: bits, size, preset and key frames; pure, each timestamp is an argument."""

from __future__ import annotations

from robotether_common.frames import KEY_FRAME_EVERY_S

from robotether_agent.video.encoder_messages import PRESETS

# Bits a pixel at quality 50, 640x480 and 15 frames a second: about the PSNR of a JPEG of quality 50 in fast scenes,
# which has 3.5 times as many, and more in calm ones.
MIDDLE_QUALITY, MIDDLE_PIXELS, MIDDLE_FPS, MIDDLE_BITS = 50, 640 * 480, 15.0, 0.2
# Number of quality steps for ten times the bits; a JPEG of quality 20 or 80 is as good as that, too.
TENFOLD = 60
# Neighbours differ less in larger frames, and frames that follow each other sooner: the exponent of both, and the rates
# for which that counts.
EXPONENT, RATED_FPS = -0.25, (5.0, 60.0)
MIN_BITS_PER_S = 20_000
MIN_SIDE = 16
# Part of a frame's interval that encoding may take, and below which there is room for a slower preset.
BUSY, EASY = 0.3, 0.1
# Part of the interval above which the fastest preset does not keep the rate, and the time until that is certain.
OVERLOADED, OVERLOADED_S = 0.6, 3.0
# Time with room before a slower preset, and its maximum where that was wrong before; a change costs a key frame.
SLOWER_AFTER_S, MAX_SLOWER_AFTER_S = 30.0, 600.0
# Time after a slower preset in which a faster one shows that it was wrong.
REGRET_S = 60.0
# Number of frames after a change that count for nothing, number of those before the next change, and weight of a frame.
SETTLING_FRAMES, JUDGED_FRAMES, WEIGHT = 5, 15, 0.1
# Maximum part of the interval that one frame counts for: one that waited for the processor proves nothing.
MAX_SHARE = 2.0


def bits_per_s(quality: int, size: tuple[int, int], fps: float) -> int:
    """Return the bits a second for frames of a JPEG quality (1 to 100), size in pixels, and rate."""
    slowest, fastest = RATED_FPS
    pixels, rated_fps = size[0] * size[1], min(fastest, max(slowest, fps))
    bits = MIDDLE_BITS * 10 ** ((quality - MIDDLE_QUALITY) / TENFOLD)
    bits *= (pixels / MIDDLE_PIXELS * rated_fps / MIDDLE_FPS) ** EXPONENT
    return max(MIN_BITS_PER_S, int(bits * pixels * fps))


def encoded_size(
    own: tuple[int, int], requested: tuple[int, int] | None, scale: float
) -> tuple[int, int]:
    """Return the size of an encoded frame: the camera's shape, within what is requested, times `scale`; sides even."""
    if requested is not None:
        scale *= min(1.0, requested[0] / own[0], requested[1] / own[1])
    # A hundredth of a pixel: 0.35 times 640 is 223.99999.
    width, height = (max(MIN_SIDE, int(side * scale + 0.01) // 2 * 2) for side in own)
    return width, height


class PresetSteps:
    """Which preset is in force, by how long frames take of the interval between them."""

    def __init__(self, now_s: float) -> None:
        self._at = 0
        self._slower_after_s = SLOWER_AFTER_S
        self._slower_at_s = now_s - REGRET_S
        self._overloaded_since_s: float | None = None
        self._begin(now_s)

    @property
    def preset(self) -> str:
        """The preset in force."""
        return PRESETS[self._at]

    def on_encoded(self, now_s: float, took_s: float, interval_s: float) -> bool:
        """Note how long a frame took; return False when not even the fastest preset keeps the rate."""
        self._frames += 1
        if self._frames <= SETTLING_FRAMES:
            return True
        share = min(MAX_SHARE, took_s / interval_s)
        if self._frames == SETTLING_FRAMES + 1:
            self._share = share
        self._share += WEIGHT * (share - self._share)
        if self._frames > JUDGED_FRAMES:
            self._step(now_s)
        return not self._is_overloaded(now_s)

    def restart(self, now_s: float) -> None:
        """Begin again with the preset in force, after a time without an encoder."""
        self._overloaded_since_s = None
        self._begin(now_s)

    def _step(self, now_s: float) -> None:
        if self._share >= EASY:
            self._easy_since_s = now_s
        if self._share > BUSY and self._at + 1 < len(PRESETS):
            if now_s - self._slower_at_s < REGRET_S:
                self._slower_after_s = min(MAX_SLOWER_AFTER_S, 2 * self._slower_after_s)
            self._at += 1
            self._begin(now_s)
        elif self._at and now_s - self._easy_since_s >= self._slower_after_s:
            self._at -= 1
            self._slower_at_s = now_s
            self._begin(now_s)

    def _is_overloaded(self, now_s: float) -> bool:
        if self._at + 1 < len(PRESETS) or self._share <= OVERLOADED:
            self._overloaded_since_s = None
            return False
        if self._overloaded_since_s is None:
            self._overloaded_since_s = now_s
        return now_s - self._overloaded_since_s >= OVERLOADED_S

    def _begin(self, now_s: float) -> None:
        self._frames = 0
        self._share = 0.0
        self._easy_since_s = now_s


class KeyFrameLimiter:
    """Whether the next frame is to be a key frame: by request, and at most one in KEY_FRAME_EVERY_S."""

    def __init__(self) -> None:
        self._is_requested = False
        self._last_s: float | None = None

    def request(self) -> None:
        """Note that the receiver cannot decode without one."""
        self._is_requested = True

    def is_due(self, now_s: float) -> bool:
        """Whether a frame that is encoded now is to be one."""
        return self._is_requested and (
            self._last_s is None or now_s - self._last_s >= KEY_FRAME_EVERY_S
        )

    def on_key_frame(self, now_s: float) -> None:
        """Note that there is one, which answers all requests."""
        self._is_requested = False
        self._last_s = now_s
