"""The topics of our own in a file: what the relay alone knows of a drive, and the frames of cameras.

docs/howto/recordings.md lists them. A robot's own topics keep their names; those here are below /robotether, where
a robot's topics are not recorded. The relay's messages are written by `relay/channels/recorder`.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any, NamedTuple

from robotether_server.contract.recordings import (
    CDR_START,
    IMAGE_SUFFIX,
    NAMESPACE,
    NS_PER_S,
    VIDEO_SUFFIX,
    ros_time,
)
from robotether_server.recorder.cdr import COUNT, Encoder, encoder_of
from robotether_server.recorder.mcap_file import RecordedChannel, RecordedMessage
from robotether_server.recorder.ros_types import RosType, parse_definition

STAMP = struct.Struct("<iI")
# Maximum time of a stamp; a robot's clock may say anything.
MAX_STAMP_NS = (2**31 - 1) * NS_PER_S

# A number that is not known is NaN, or -1 where it is a whole one.
DRIVE_COMMAND = """\
builtin_interfaces/Time stamp  # when the relay dealt with it
string topic
string person
int64 fence  # number of the lease
float64 age_ms  # at least, on its way from the driver's hand to the relay
string outcome  # sent, or why it was not: too_old, ahead, replaced, clock_unknown
float64 speed_m_s
float64 turn_rad_s
string message  # JSON, as it was sent
string[] seen_cameras  # the frames that the driver's page showed
int64[] seen_frames  # their numbers, in the order of the cameras
"""
ROUND_TRIP = """\
builtin_interfaces/Time stamp
string person
float64 driver_ms  # between relay and driver
float64 robot_ms  # between relay and robot
"""
SEEN_AGE = """\
builtin_interfaces/Time stamp
int64 fence
float64[] ages_ms  # of what the driver saw, at the newest commands that reached the robot
float64 slowed_s  # for which the robot was slowed since the last of these
float64 max_speed_m_s  # to which the newest command was slowed
float64 max_turn_rad_s
"""
CONTROL = """\
builtin_interfaces/Time stamp  # a message comes when something of it changes
bool online
string driver  # empty: nobody
int64 fence  # -1: the relay is not heard, or has not the robot; from here on nothing of this is known
bool stopped
string stopped_by
bool stop_confirmed  # by the robot's guard
string guard
"""
LEFT_OUT = """\
builtin_interfaces/Time stamp  # from here on the file has no messages of topics that are new to it
string topic  # the first of them
"""
TEXT = "string data  # JSON\n"
COMPRESSED_IMAGE = "std_msgs/Header header\nstring format\nuint8[] data\n"
COMPRESSED_VIDEO = (
    "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n"
)

_IMAGE = parse_definition("sensor_msgs/CompressedImage", COMPRESSED_IMAGE)
_VIDEO = parse_definition("foxglove_msgs/CompressedVideo", COMPRESSED_VIDEO)
# A message whose type nobody can describe, as text.
JSON_TEXT = parse_definition("std_msgs/String", TEXT)


class OwnTopic(NamedTuple):
    """A topic of ours, and what writes its messages."""

    channel: RecordedChannel
    encode: Encoder


def channel_of(topic: str, ros_type: RosType) -> RecordedChannel:
    """Return the channel of a topic."""
    return RecordedChannel(topic, ros_type.full_name, ros_type.definition())


def _own(name: str, kind: str, definition: str) -> OwnTopic:
    ros_type = parse_definition(f"robotether_msgs/{kind}", definition)
    channel = RecordedChannel(
        f"{NAMESPACE}{name}", ros_type.full_name, _with_comments(ros_type, definition)
    )
    return OwnTopic(channel, encoder_of(ros_type))


def _with_comments(ros_type: RosType, definition: str) -> str:
    _, separator, inner = ros_type.definition().partition("=" * 80)
    return definition + separator + inner


UNKNOWN_CONTROL: Mapping[str, Any] = {
    "online": False,
    "driver": "",
    "fence": -1,
    "stopped": False,
    "stopped_by": "",
    "stop_confirmed": False,
    "guard": "",
}
# By the names that the relay gives them.
OWN_TOPICS: Mapping[str, OwnTopic] = {
    "commands": _own("commands", "DriveCommand", DRIVE_COMMAND),
    "round_trips": _own("round_trips", "RoundTrip", ROUND_TRIP),
    "seen_ages": _own("seen_ages", "SeenAge", SEEN_AGE),
    "control": _own("control", "Control", CONTROL),
}
_LEFT_OUT = _own("left_out", "LeftOut", LEFT_OUT)


def left_out_note(message: RecordedMessage) -> RecordedMessage:
    """Return what a file says in place of the first message of a topic that finds no room."""
    members = {"stamp": ros_time(message.log_ns), "topic": message.channel.topic}
    return message._replace(channel=_LEFT_OUT.channel, sequence=0, data=_LEFT_OUT.encode(members))


class CameraWriter:
    """Writes the frames of one camera of one codec as they came.

    JPEG as sensor_msgs/CompressedImage, all else as foxglove_msgs/CompressedVideo: these are the messages of ROS 2
    that Foxglove's schemas foxglove.CompressedImage and foxglove.CompressedVideo stand for.
    """

    def __init__(self, camera: str, codec: str) -> None:
        self._is_image = codec == "jpeg"
        ros_type = _IMAGE if self._is_image else _VIDEO
        suffix = IMAGE_SUFFIX if self._is_image else VIDEO_SUFFIX
        self._channel = channel_of(camera.rstrip("/") + suffix, ros_type)
        self._codec = codec.encode() + b"\0"
        frame_id = camera.encode() + b"\0"
        self._frame_id = COUNT.pack(len(frame_id)) + frame_id

    def message(self, data: bytes, *, log_ns: int, taken_ns: int, sequence: int) -> RecordedMessage:
        """Return the message of a frame that was taken at `taken_ns`; `sequence` is its number at the relay."""
        taken_ns = min(max(taken_ns, 0), MAX_STAMP_NS)
        sec, nanosec = divmod(taken_ns, NS_PER_S)
        begin = STAMP.pack(sec, nanosec) + self._frame_id
        if self._is_image:
            begin = _aligned(begin) + COUNT.pack(len(self._codec)) + self._codec
        begin = _aligned(begin) + COUNT.pack(len(data))
        parts = [CDR_START, begin, data]
        if not self._is_image:
            padding = bytes(-(len(begin) + len(data)) % COUNT.size)
            parts += [padding, COUNT.pack(len(self._codec)), self._codec]
        return RecordedMessage(self._channel, log_ns, taken_ns, sequence, b"".join(parts))


def _aligned(data: bytes) -> bytes:
    return data + bytes(-len(data) % COUNT.size)
