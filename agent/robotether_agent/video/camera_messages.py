"""What the process of an RTSP or V4L2 camera writes: frames, and at the end the reason."""

from __future__ import annotations

import struct

from robotether_common.frames import MAX_FRAME_BYTES

# Kind, and the frame's arrival in seconds of the robot's clock; then a JPEG, or the reason why there are no more.
FRAME_HEADER = struct.Struct("!Bd")
FRAME, REASON = 0, 1
MAX_MESSAGE_BYTES = FRAME_HEADER.size + MAX_FRAME_BYTES
