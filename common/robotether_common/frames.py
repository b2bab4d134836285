"""The frames protocol (docs/reference/media.md) as agent and relay know it: frame header, stream request, and bounds.

Both speak it with each other, and the relay with viewers, too. How each reads the other's texts is its own.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Literal, get_args

PATH = "/robotether/frames"
# Codec, flags, quality, sequence, and the timestamp in ms.
HEADER = struct.Struct("!BBHId")
# Flag of a frame with the camera's own timestamp.
STAMPED = 1
# Flag of a frame that can be shown without those before it.
KEY = 2
SEQUENCES = 2**32
MAX_FRAME_BYTES = 10 * 1024 * 1024
# Maximum size of a frame of a codec that depends on earlier frames, which receivers keep for a while.
MAX_DEPENDENT_FRAME_BYTES = 2 * 1024 * 1024
# Minimum interval in seconds between two key frames that are sent because they were requested.
KEY_FRAME_EVERY_S = 0.5
MAX_TEXT_BYTES = 4096
# Number of frames that a receiver grants at first, and maximum number of those that it may have granted and not yet
# received: more where the way is long.
CREDITS, MAX_CREDITS = 2, 8

# Maximum values of a stream request.
MAX_SIDE = 4096
QUALITIES = (1, 100)
FPS = (0.1, 60)
LATENCIES_MS = (50, 5000)
SIDES = (1, MAX_SIDE)

# Query of web_video_server beside the camera. Without it, it does not receive ROS 2 cameras that publish
# best effort, as sensors do. With it, it receives reliable ones, too. ROS 1 ignores it.
QOS_NAME = "qos_profile"
QOS = f"{QOS_NAME}=sensor_data"

# Reason of a status for JPEGs that come before an encoder is ready.
ENCODER_STARTS = "the encoder starts"

State = Literal["live", "waiting", "down"]
# What a receiver keeps where the line does not carry all: size and quality of frames, or their rate.
Preference = Literal["sharp", "smooth"]
PREFERENCES = get_args(Preference)
Source = Literal["web_video_server", "mjpeg", "rosbridge"]


def no_frames(topic: str) -> str:
    """Return why a topic gives no frames, as agent and relay say it to people; the name is anybody's text."""
    name = "".join(each if each.isprintable() else " " for each in topic[:100])
    return f"no frames from {name}: the topic does not exist, nothing publishes it, or too rarely"


@dataclass(frozen=True)
class StreamRequest:
    """What a receiver wants to see; width and height are both None for the camera's own size."""

    quality_min: int = 20
    quality_max: int = 80
    fps: float = 15
    latency_ms: float = 300
    width: int | None = None
    height: int | None = None
    # Names of the codecs that the receiver decodes, in the order of `codecs.NAMES`.
    codecs: tuple[str, ...] = ("jpeg",)
    # None leaves it to the sender.
    prefers: Preference | None = None
    # Where the line does not carry all, what else the robot sends goes first.
    yields: bool = False


@dataclass(frozen=True)
class VideoStatus:
    """How the source of a robot's frames is, and what it sends; None: not known.

    `encoder` is the name of the encoder at work, None while frames are JPEGs as the source gave them; `no_encoder` says
    why a receiver that decodes more gets them, or why the encoder makes fewer than requested, and is empty else.
    """

    state: State
    detail: str = ""
    source: Source | None = None
    quality: float | None = None
    width: float | None = None
    height: float | None = None
    fps: float | None = None
    codec: str | None = None
    encoder: str | None = None
    no_encoder: str = ""
