"""Decides how a camera's frames are encoded: bits, size, preset, rate and key frames; pure, times are arguments."""

from __future__ import annotations

from math import inf, sqrt

from robotether_common.frames import KEY_FRAME_EVERY_S, MAX_SIDE

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
# Maximum number of pixels of an encoded frame: more take too much time and memory of a robot.
MAX_PIXELS = 1920 * 1080
# Part of a frame's interval that encoding may take, and below which there is room for a slower preset.
BUSY, EASY = 0.3, 0.1
# Part of the interval above which the fastest preset does not keep the rate, the time until that is certain, and the
# part at the lower rate that follows.
OVERLOADED, OVERLOADED_S, RELIEVED = 0.6, 3.0, 0.4
# Minimum rate to which frames are slowed, in frames a second: with fewer, JPEGs are the better picture.
MIN_SLOWED_FPS = 5.0
# Ratio of the next higher rate to the one before.
FASTER = 1.5
# Time with room before a step up, and its maximum where that was wrong before; another preset costs a key frame. A step
# up that held for the maximum was right.
UP_AFTER_S, MAX_UP_AFTER_S = 30.0, 600.0
# Time after a step up in which a step down shows that it was wrong.
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
    """Return the size of an encoded frame: the camera's shape, within what is requested and MAX_PIXELS; sides even."""
    if requested is not None:
        scale *= min(1.0, requested[0] / own[0], requested[1] / own[1])
    scale = min(scale, sqrt(MAX_PIXELS / (own[0] * own[1])), MAX_SIDE / max(own))
    # A hundredth of a pixel: 0.35 times 640 is 223.99999.
    width, height = (max(MIN_SIDE, int(side * scale + 0.01) // 2 * 2) for side in own)
    return width, height


class LoadSteps:
    """Preset and maximum rate in force, by how long frames take of the interval between them.

    Down: the preset first, then the rate. Up after a time with room: the rate first.
    """

    def __init__(self, now_s: float) -> None:
        self.max_fps = inf
        self._at = 0
        self._up_after_s = UP_AFTER_S
        self._up_at_s = now_s - REGRET_S
        self.restart(now_s)

    @property
    def preset(self) -> str:
        """The preset in force."""
        return PRESETS[self._at]

    def on_encoded(self, now_s: float, took_s: float, fps: float) -> bool:
        """Note how long a frame took, of `fps` that come a second; return False when no step is low enough."""
        self._frames += 1
        if self._frames <= SETTLING_FRAMES:
            return True
        fps = min(fps, self.max_fps)
        share = min(MAX_SHARE, took_s * fps)
        if self._frames == SETTLING_FRAMES + 1:
            self._share = share
        self._share += WEIGHT * (share - self._share)
        return self._frames <= JUDGED_FRAMES or self._step(now_s, fps)

    def restart(self, now_s: float) -> None:
        """Judge the steps in force anew, as after a time without an encoder."""
        self._frames = 0
        self._share = 0.0
        self._room_since_s = now_s
        self._overloaded_since_s: float | None = None

    def _step(self, now_s: float, fps: float) -> bool:
        if self._share > BUSY and self._at + 1 < len(PRESETS):
            self._at += 1
            self._on_down(now_s)
        elif self._is_overloaded(now_s):
            if self.max_fps <= MIN_SLOWED_FPS:
                return False
            self.max_fps = max(MIN_SLOWED_FPS, RELIEVED * fps / self._share)
            self._on_down(now_s)
        elif not self._has_room(fps):
            self._room_since_s = now_s
        elif now_s - self._room_since_s >= self._up_after_s:
            self._step_up(now_s, fps)
        return True

    def _has_room(self, fps: float) -> bool:
        if self.max_fps == inf:
            return self._at > 0 and self._share < EASY
        return self._is_unneeded(fps) or FASTER * self.max_fps * self._share <= RELIEVED * fps

    def _is_unneeded(self, fps: float) -> bool:
        """Whether the camera gives clearly fewer frames than the maximum rate."""
        return FASTER * fps <= self.max_fps

    def _step_up(self, now_s: float, fps: float) -> None:
        if self.max_fps == inf:
            self._at -= 1
        else:
            self.max_fps = inf if self._is_unneeded(fps) else FASTER * self.max_fps
        self._up_at_s = now_s
        self.restart(now_s)

    def _on_down(self, now_s: float) -> None:
        held_s = now_s - self._up_at_s
        if held_s < REGRET_S:
            self._up_after_s = min(MAX_UP_AFTER_S, 2 * self._up_after_s)
        elif held_s >= MAX_UP_AFTER_S:
            self._up_after_s = UP_AFTER_S
        self.restart(now_s)

    def _is_overloaded(self, now_s: float) -> bool:
        if self._share <= OVERLOADED:
            self._overloaded_since_s = None
            return False
        if self._overloaded_since_s is None:
            self._overloaded_since_s = now_s
        return now_s - self._overloaded_since_s >= OVERLOADED_S


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
