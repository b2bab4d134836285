"""Which frames of a camera wait for one receiver's credit; pure, each timestamp is an argument.

With JPEG it is the newest. With a codec that depends on earlier frames, which a robot encodes itself, it is each frame
from a key frame on, and none once one has waited too long: then the next key frame is the first.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from robotether_common.frames import MAX_DEPENDENT_FRAME_BYTES

from robotether_agent.video.sources import CameraFrame, SourceRequest

# Maximum time for which a frame waits that others depend on, as at the relay.
HELD_S = 0.3
MAX_WAITING = 32
MAX_WAITING_BYTES = 2 * MAX_DEPENDENT_FRAME_BYTES
# Time without a key frame that is reported.
KEY_LATE_S = 2.0


@dataclass(frozen=True)
class NewFrame:
    """A camera's frame that nobody has sent yet."""

    sequence: int
    frame: CameraFrame
    source_request: SourceRequest


class WaitingFrames:
    """The frames that wait, oldest first."""

    def __init__(self) -> None:
        self._frames: deque[NewFrame] = deque()
        self._source_request: SourceRequest | None = None
        # Whether a frame may come that depends on the newest; since when such frames come in vain.
        self._continues = False
        self._lacks_key_since_s: float | None = None

    def __bool__(self) -> bool:
        return bool(self._frames)

    def put(self, new: NewFrame, now_s: float) -> None:
        """Let a frame wait, in place of those that need not be sent any more."""
        if new.source_request != self._source_request:
            # Some of its frames may be missing, or come twice.
            self.clear()
            self._source_request = new.source_request
        if not new.frame.codec.depends_on_earlier or new.frame.is_key:
            self.clear()
            self._continues, self._lacks_key_since_s = new.frame.codec.depends_on_earlier, None
        elif not self._continues or self._is_late(now_s):
            self.clear()
            if self._lacks_key_since_s is None:
                self._lacks_key_since_s = now_s
            return
        self._frames.append(new)

    def next(self) -> NewFrame | None:
        """Return the frame that is sent next, and let it wait no more."""
        return self._frames.popleft() if self._frames else None

    def clear(self) -> None:
        """Let nothing wait: of a codec that depends on earlier frames a key frame is the next."""
        self._frames.clear()
        self._continues = False

    def lack(self, now_s: float) -> str:
        """Return why nothing is sent although frames come; empty where that is not so."""
        since_s = self._lacks_key_since_s
        if since_s is None or now_s - since_s < KEY_LATE_S:
            return ""
        return (
            f"no key frame for {now_s - since_s:.0f} s, with which this H.264 can be shown; "
            "let the robot's encoder make one each second"
        )

    def _is_late(self, now_s: float) -> bool:
        frames = self._frames
        return bool(frames) and (
            now_s - frames[0].frame.arrived_s > HELD_S
            or len(frames) >= MAX_WAITING
            or sum(len(new.frame.data) for new in frames) > MAX_WAITING_BYTES
        )
