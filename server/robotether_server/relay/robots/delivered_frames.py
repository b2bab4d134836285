"""The frames of one robot that each user was sent lately, under the robot's own numbers.

A drive command names the frame that its driver saw by the number that the viewer got. Robots count their frames
themselves, so the relay translates. What a user was not sent is unknown, whatever a client claims. Pure.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from msgspec import Struct
from robotether_common.guard import MAX_FRAMES, MAX_SEEN_S


class NamedFrame(Struct, frozen=True, gc=False):
    """A frame of a camera, as the guard reads it in JSON; `frame` None: unknown."""

    camera: str
    frame: int | None


class DeliveredFrames:
    """All frames of one robot that were sent in the last MAX_SEEN_S."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        # By user and camera, then by the number that the viewer got: the robot's own, and when it was sent. None: two
        # feeds of the camera gave this number, and nobody knows which of both frames is named.
        self._frames: dict[tuple[int, str], dict[int, tuple[int | None, float]]] = {}

    def note(self, user_id: int, camera: str, sequence: int, robot_sequence: int) -> None:
        """A user is sent this frame."""
        now = self._clock()
        frames = self._frames.get((user_id, camera))
        if frames is None:
            self._forget_gone(now)
            frames = self._frames[user_id, camera] = {}
        before = frames.pop(sequence, None)
        is_other = before is not None and before[0] != robot_sequence and not _is_old(before, now)
        frames[sequence] = (None if is_other else robot_sequence, now)
        while len(frames) > MAX_FRAMES or _is_old(next(iter(frames.values())), now):
            del frames[next(iter(frames))]

    def robots(self, user_id: int, named: NamedFrame) -> NamedFrame:
        """Return the frame under the robot's own number; unknown if this user was not sent it."""
        frames = self._frames.get((user_id, named.camera), {})
        sent = None if named.frame is None else frames.get(named.frame)
        if sent is None or _is_old(sent, self._clock()):
            return NamedFrame(named.camera, None)
        return NamedFrame(named.camera, sent[0])

    def _forget_gone(self, now: float) -> None:
        """Forget users and cameras of whom nothing was sent lately."""
        self._frames = {
            key: frames
            for key, frames in self._frames.items()
            if not _is_old(next(reversed(frames.values())), now)
        }


def _is_old(sent: tuple[int | None, float], now: float) -> bool:
    return now - sent[1] > MAX_SEEN_S
