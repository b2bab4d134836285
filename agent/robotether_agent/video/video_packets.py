"""H.264 that a robot encodes by itself, of foxglove_msgs/CompressedVideo and ffmpeg_image_transport_msgs/FFMPEGPacket.

Read by `sources`, which passes it on, and by `image_process`, which decodes it for receivers that do not.
"""

from __future__ import annotations

import binascii

from robotether_common.frames import MAX_DEPENDENT_FRAME_BYTES

from robotether_agent.fields import JsonObject, printable
from robotether_agent.problems import DetailError
from robotether_agent.video.h264 import AccessUnit, access_unit

# Names of H.264 in both types: `format` of the one, and of the other `encoding`, which begins with the encoder's.
H264_NAMES = ("h264", "x264", "avc")


class NotShownError(DetailError):
    """A robot's video cannot be shown; the message says why."""


def h264_of(message: JsonObject) -> tuple[bytes, AccessUnit] | None:
    """Return the access unit of a message of either type, nothing for one without a frame; NotShownError."""
    encoding = str(message.get("format", message.get("encoding", "")))
    encoding = encoding.partition(";")[0].lower().replace(".", "")
    if not any(name in encoding for name in H264_NAMES):
        raise NotShownError(f"its video has the format {printable(encoding, 40)}, not H.264")
    if message.get("data") == "":
        return None
    try:
        data = binascii.a2b_base64(message.get("data", ""))  # type: ignore[arg-type]
    except (TypeError, ValueError) as error:
        raise NotShownError("its video makes no sense") from error
    unit = access_unit(data)
    if unit is None:
        raise NotShownError("its H.264 is not in Annex B")
    _check(unit, len(data))
    return (data, unit) if unit.has_slice else None


def _check(unit: AccessUnit, length: int) -> None:
    """Raise why a viewer could not decode the frame at once."""
    if unit.is_bidirectional:
        raise NotShownError("its H.264 has B frames, which come late; encode without them")
    if unit.is_key and not unit.is_complete:
        raise NotShownError("its H.264 has key frames without parameter sets (SPS, PPS)")
    if length > MAX_DEPENDENT_FRAME_BYTES:
        raise NotShownError(f"its H.264 has a frame of {length} bytes")
