"""The frames of a camera that a viewer can still get: the newest, and those that it needs to decode the newest.

Each feed of `feeds` has one, which each viewer's `Cursor` reads. With a codec that depends on earlier frames it holds
the frames of the last HELD_S since a key frame, so that a viewer that is a little late misses none. Pure.
"""

from __future__ import annotations

from collections import deque

from robotether_common.frames import MAX_CREDITS, MAX_DEPENDENT_FRAME_BYTES

from robotether_server.relay.channels.video.frame_protocol import Frame

# Time for which a frame that others depend on is held: what a lost packet costs a viewer on a mobile line.
HELD_S = 0.3
# Maximum number of frames, for a robot that sends more of them than it may.
MAX_HELD = 32
# Number of the newest frames that are held however old: where one viewer alone takes them, the robot sends no more
# than these before it has taken one.
MIN_HELD = MAX_CREDITS
# Maximum size of all held frames; a JPEG alone may be larger.
MAX_HELD_BYTES = 2 * MAX_DEPENDENT_FRAME_BYTES


class HeldFrames:
    """Consecutive frames up to the newest; the first is a key frame as long as none after it was dropped."""

    def __init__(self) -> None:
        self.newest: Frame | None = None
        self._frames: deque[Frame] = deque()
        self._bytes = 0
        # Whether a frame may come that depends on the newest.
        self._continues = False

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def start(self) -> Frame | None:
        """The key frame after which all are held; None: nobody can begin here."""
        first = self._frames[0] if self._frames else None
        return first if first is not None and first.is_key else None

    def at(self, position: int) -> Frame | None:
        """Return the frame with this position, None when it is not held."""
        index = position - self._frames[0].position if self._frames else -1
        return self._frames[index] if 0 <= index < len(self._frames) else None

    def break_chain(self) -> None:
        """A frame is missing: what comes next must be a key frame."""
        self._continues = False

    def add(self, frame: Frame) -> bool:
        """Hold the next frame; False, and it is not held, when it depends on frames that did not come."""
        if frame.is_key:
            self._frames.clear()
            self._bytes = 0
        elif not self._continues or self.newest is None or self.newest.codec is not frame.codec:
            self.break_chain()
            return False
        self.newest, self._continues = frame, True
        self._frames.append(frame)
        self._bytes += frame.size
        self._drop_oldest(frame.received_s - HELD_S)
        return True

    def _drop_oldest(self, oldest_s: float) -> None:
        while len(self._frames) > 1 and (
            self._bytes > MAX_HELD_BYTES
            or len(self._frames) > MAX_HELD
            or (len(self._frames) > MIN_HELD and self._frames[0].received_s < oldest_s)
        ):
            self._bytes -= self._frames.popleft().size
