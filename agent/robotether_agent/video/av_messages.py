"""How the agent and its processes with PyAV write messages to each other, and what a process that gives frames writes.

That is frames, and at the end the reason. The encoder's messages are in `encoder_messages`.
"""

from __future__ import annotations

import struct

from robotether_common.frames import MAX_FRAME_BYTES

LENGTH = struct.Struct("!I")
# Kind, whether the camera stamped the frame, its timestamp and its arrival in seconds of the robot's clock. Then a
# JPEG, or the reason why there are no more.
FRAME_HEADER = struct.Struct("!B?dd")
FRAME, REASON = 0, 1
MAX_MESSAGE_BYTES = FRAME_HEADER.size + MAX_FRAME_BYTES


def framed(message: bytes) -> bytes:
    """Return a message as it is sent, after its length."""
    return LENGTH.pack(len(message)) + message
