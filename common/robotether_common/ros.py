"""Names of ROS, patterns for them, members of messages that drive a robot, topics of cameras, and bytes sent as text.

In a pattern `*` matches any text, `/` included; a robot's policy and its drive topics are made of them. The time
that a look takes grows with the lengths of name and pattern and no faster, whoever chose either; so no regular
expressions there. Pure.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Iterator, Mapping

MAX_NAME_LENGTH = 255
# A name of ROS without a pattern in it.
NAME = re.compile(r"/?[A-Za-z0-9_]+(?:/[A-Za-z0-9_]+)*")
MAX_GLOBS = 64
MAX_GLOB_LENGTH = 256
# What a name is made of, and `*`. Anything else could never match.
GLOB_PATTERN = "^[/*][a-zA-Z0-9_/*]*$"
_GLOB = re.compile(GLOB_PATTERN.removesuffix("$") + r"\Z")

# Members of geometry_msgs/Twist and TwistStamped, and of ackermann_msgs/AckermannDriveStamped.
AXES = ("x", "y", "z")
TWIST = frozenset(("linear", "angular"))
TWIST_STAMPED = frozenset(("header", "twist"))
ACKERMANN_STAMPED = frozenset(("header", "drive"))
ACKERMANN_RATES = ("steering_angle_velocity", "acceleration", "jerk")
ACKERMANN = frozenset(("steering_angle", "speed", *ACKERMANN_RATES))

RAW_IMAGE_TYPE = "sensor_msgs/Image"
IMAGE_TYPE = "sensor_msgs/CompressedImage"
# Video that the robot encodes by itself.
VIDEO_TYPES = ("foxglove_msgs/CompressedVideo", "ffmpeg_image_transport_msgs/FFMPEGPacket")
COMPRESSED = "/compressed"
# Endings of what image_transport publishes as CompressedImage and no browser shows.
NOT_SHOWN = ("/compressedDepth", "/zstd")
USUAL_CAMERA = "/camera/image_raw"


def camera_topics(types: Mapping[str, str]) -> list[str]:
    """Return the cameras among a robot's topics, the usual one first, as on the drive page (discovery.js).

    `types`: the type of each topic, without the `msg` of ROS 2.
    """
    raw = {name for name, kind in types.items() if kind == RAW_IMAGE_TYPE}
    # What lies under a raw image is that image by another transport.
    alone = (
        name
        for name, kind in types.items()
        if (kind == IMAGE_TYPE and not name.endswith(NOT_SHOWN)) or kind in VIDEO_TYPES
        if name.rpartition("/")[0] not in raw
    )
    cameras = raw | {name.removesuffix(COMPRESSED) or name for name in alone}
    return sorted(cameras, key=lambda name: (name != USUAL_CAMERA, name))


def full_name(name: object) -> str | None:
    """Return the name with its first slash, or None if it is spelled in any other way."""
    if not isinstance(name, str) or len(name) > MAX_NAME_LENGTH or not NAME.fullmatch(name):
        return None
    return name if name[0] == "/" else "/" + name


def is_glob(text: str) -> bool:
    """Whether the text can match any name at all: a full name begins with `/`."""
    return len(text) <= MAX_GLOB_LENGTH and _GLOB.match(text) is not None and "//" not in text


class Globs:
    """Some patterns; a name matches when one of them does. Equal when the patterns are."""

    __slots__ = ("_plain", "_split", "patterns")

    def __init__(self, patterns: Iterable[str] = ()) -> None:
        self.patterns = tuple(patterns)
        self._plain = frozenset(pattern for pattern in self.patterns if "*" not in pattern)
        self._split = tuple(
            tuple(pattern.split("*")) for pattern in self.patterns if "*" in pattern
        )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Globs) and self.patterns == other.patterns

    def __hash__(self) -> int:
        return hash(self.patterns)

    def __repr__(self) -> str:
        return f"Globs({list(self.patterns)})"

    def __iter__(self) -> Iterator[str]:
        return iter(self.patterns)

    def match(self, name: str) -> bool:
        """Whether the whole name matches one of the patterns."""
        return name in self._plain or any(_matches(parts, name) for parts in self._split)


def _matches(parts: tuple[str, ...], name: str) -> bool:
    """Whether the name is these parts, in this order, with any text between them."""
    first, *middle, last = parts
    end = len(name) - len(last)
    if not (len(first) <= end and name.startswith(first) and name.endswith(last)):
        return False
    place = len(first)
    for part in middle:
        # The earliest place leaves most to the parts that follow, so there is nothing to try again.
        start = name.find(part, place, end)
        if start < 0:
            return False
        place = start + len(part)
    return True


def octet_of(text: str) -> int:
    """Return the byte that a bridge wrote as text: the digit of a level, a character, or base64.

    Raises ValueError for what is none.
    """
    if len(text) == 1:
        return int(text) if text in "0123" else ord(text)
    (octet,) = base64.b64decode(text, validate=True)
    return octet
