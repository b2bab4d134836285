"""Reads raw images of a ROS topic: `python -m robotether_agent.video.image_process`, which one on stdin, JPEGs on stdout.

Started by video.sources, one for an open topic. It subscribes at rosbridge by itself, so that images of some MB pass
none of the agent's own loop. Makes a frame of the newest image alone.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from typing import Any

import aiohttp
import av

from robotether_agent.describe_error import describe_error
from robotether_agent.rosbridge import (
    CONNECT_WITHIN_S,
    MAX_IMAGE_MESSAGE_BYTES,
    RAW_IMAGE_TYPE,
    connected,
)
from robotether_agent.video.av_program import private_output, step_back
from robotether_agent.video.newest_jpegs import (
    CameraFailedError,
    DecodedFrame,
    NewestFrame,
    serve,
)
from robotether_agent.video.raw_images import FrameMaker, RawImage
from robotether_agent.video.timestamps import now, stamp_of, timestamp_of


def read(request: Mapping[str, Any], newest: NewestFrame) -> None:
    """Read a topic's images until there are no more, and say why."""
    try:
        asyncio.run(subscribe(request, newest))
    except CameraFailedError as error:
        newest.end(error)
    except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
        newest.end(CameraFailedError(describe_error(error, CONNECT_WITHIN_S)))


async def subscribe(request: Mapping[str, Any], newest: NewestFrame) -> None:
    """Put each image with its times."""
    maker = FrameMaker()
    async with connected(request["url"], max_message_bytes=MAX_IMAGE_MESSAGE_BYTES) as rosbridge:
        throttle_ms = request["throttle_ms"]
        await rosbridge.subscribe(request["topic"], RAW_IMAGE_TYPE, throttle_ms=throttle_ms)
        while True:
            message = await rosbridge.message()
            arrived = now()
            timestamp_s, is_stamped = timestamp_of(stamp_of(message), arrived)
            frame = partial(maker.frame, RawImage.of(message))
            newest.put(DecodedFrame(frame, arrived.robot_s, timestamp_s, is_stamped))


def main() -> int:
    """Run the process."""
    step_back()
    av.logging.set_level(av.logging.PANIC)
    request = json.loads(sys.stdin.buffer.readline())
    with suppress(BrokenPipeError):
        serve(partial(read, request), private_output())
    return 0


if __name__ == "__main__":
    sys.exit(main())
