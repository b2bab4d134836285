"""How the file of a recording is laid out: the recorder writes it, and the export for training reads it."""

import struct
from collections.abc import Mapping

MAGIC = b"\x89MCAP0\r\n"
# Opcode and length of a record of MCAP.
RECORD = struct.Struct("<BQ")
# The beginning of each message: CDR, little endian, no options. Alignment counts from its end.
CDR_START = b"\0\1\0\0"
# Topics of our own; a robot's topics below it are not recorded.
NAMESPACE = "/robotether/"
# What follows a camera's name in the topic of its JPEGs, and of all else.
IMAGE_SUFFIX, VIDEO_SUFFIX = "/compressed", "/video"
NS_PER_S = 1_000_000_000


def ros_time(at_ns: int) -> Mapping[str, int]:
    """Return a time, in ns of Unix, as ROS has it."""
    sec, nanosec = divmod(at_ns, NS_PER_S)
    return {"sec": sec, "nanosec": nanosec}
