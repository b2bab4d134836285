"""Makes JPEGs of a ROS topic's images, in a process of its own: the topic on stdin, JPEGs on stdout.

Started by video.sources, one for each open topic: `python -m robotether_agent.video.image_process`. It subscribes at
rosbridge itself, so that images of some MB do not pass the agent's own loop. It makes a JPEG only of the newest raw
image, and decodes all H.264.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from functools import partial
from typing import Any

import aiohttp
import av
from robotether_common.frames import MAX_SIDE
from robotether_common.ros import VIDEO_TYPES

from robotether_agent.describe_error import describe_error
from robotether_agent.fields import JsonObject
from robotether_agent.rosbridge import MAX_IMAGE_MESSAGE_BYTES, connected
from robotether_agent.rosbridge_socket import CONNECT_WITHIN_S
from robotether_agent.video.av_program import LOW_DELAY_FLAG
from robotether_agent.video.newest_jpegs import (
    CameraFailedError,
    DecodedFrame,
    NewestFrame,
    decoded,
    main,
    reason_of,
)
from robotether_agent.video.raw_images import FrameMaker, RawImage
from robotether_agent.video.timestamps import MAX_LAG_S, FrameClock, FramesLateError, now, stamp_of
from robotether_agent.video.video_packets import NotShownError, h264_of


def read(request: str, newest: NewestFrame) -> None:
    """Read a topic's images until there are no more, and say why."""
    try:
        asyncio.run(subscribe(json.loads(request), newest))
    except (CameraFailedError, FramesLateError, NotShownError) as error:
        newest.end(CameraFailedError(str(error)))
    except (av.FFmpegError, MemoryError) as error:
        newest.end(CameraFailedError(f"its H.264 cannot be decoded: {reason_of(error)}"))
    except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
        newest.end(CameraFailedError(describe_error(error, CONNECT_WITHIN_S)))


async def subscribe(request: Mapping[str, Any], newest: NewestFrame) -> None:
    """Put each image with its times."""
    kind, clock = request["type"], FrameClock(MAX_LAG_S)
    is_video = kind in VIDEO_TYPES
    frames_of = H264Frames().frames_of if is_video else partial(raw_frames, FrameMaker())
    async with connected(request["url"], max_message_bytes=MAX_IMAGE_MESSAGE_BYTES) as rosbridge:
        await rosbridge.subscribe(request["topic"], kind, **request["how"])
        while True:
            message = await rosbridge.message()
            arrived = now()
            content = message.get("data")
            timestamp_s, is_stamped = clock.timestamp(stamp_of(message), arrived, content)
            for frame in frames_of(message):
                newest.put(DecodedFrame(frame, arrived.robot_s, timestamp_s, is_stamped))


def raw_frames(maker: FrameMaker, message: JsonObject) -> list[Any]:
    """Return what makes the frame of a message of a raw image, where that is wanted; nothing of an empty one."""
    if message.get("data") == "":
        return []
    return [partial(maker.frame, RawImage.of(message))]


class H264Frames:
    """A robot's own H.264, from its first parameter sets on: with intra refresh there is no key frame."""

    def __init__(self) -> None:
        self._decoder: Any = av.CodecContext.create("h264", "r")
        self._decoder.thread_count = 1
        self._decoder.flags |= LOW_DELAY_FLAG
        self._decoder.options = {"max_pixels": str(MAX_SIDE * MAX_SIDE)}
        self._has_begun = False

    def frames_of(self, message: JsonObject) -> list[Any]:
        """Return the frame of a message, if it has one."""
        packet = h264_of(message)
        if packet is None:
            return []
        data, unit = packet
        self._has_begun = self._has_begun or unit.is_complete
        return decoded(self._decoder, av.Packet(data)) if self._has_begun else []


if __name__ == "__main__":
    main(read)
