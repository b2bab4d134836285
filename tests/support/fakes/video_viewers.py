"""Who looks at a camera in tests and experiments: by frames (docs/reference/media.md) or a multipart stream.

Each notes of every picture the moment in which it was whole, before anything else is done with
it. They take all that comes as quickly as it comes; a slow viewer is a double of somebody else's.
"""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import aiohttp
from frame_stamp import read_stamp

HEADER = struct.Struct("!BBHId")
CREDITS = 2


@dataclass(frozen=True)
class Frame:
    """One picture and the Unix time in s at which it was whole; a stream does not tell what only frames do."""

    received_at: float
    jpeg: bytes
    # Grows by one with each picture that the camera gave, seen or not.
    number: int | None = None
    # What the camera was asked for.
    quality: int | None = None

    @property
    def age_ms(self) -> float:
        """How old what it shows was by then; NoStampError when it does not tell."""
        return (self.received_at - read_stamp(self.jpeg)) * 1000


OnFrame = Callable[[Frame], None]


async def view_frames(
    http: aiohttp.ClientSession,
    url: str,
    on_frame: OnFrame,
    stream_request: Mapping[str, Any] | None = None,
    **how: Any,
) -> None:
    """Take pictures by credit until the connection ends or the task is cancelled; `how` goes to ws_connect."""
    async with http.ws_connect(url, compress=0, max_msg_size=0, **how) as socket:
        await socket.send_json({"op": "stream_request", **(stream_request or {})})
        await socket.send_json({"op": "credit", "frames": CREDITS})
        async for message in socket:
            if message.type is aiohttp.WSMsgType.BINARY:
                received_at = time.time()
                _, _, quality, number, _ = HEADER.unpack_from(message.data)
                credit = {"op": "credit", "frames": 1, "taken": number}
                await socket.send_str(json.dumps(credit))
                on_frame(Frame(received_at, message.data[HEADER.size :], number, quality))
        raise ConnectionError(f"the frames ended with {socket.close_code}")


async def view_stream(http: aiohttp.ClientSession, url: str, on_frame: OnFrame, **how: Any) -> None:
    """Take pictures out of a multipart stream until it ends or the task is cancelled; `how` goes to get."""
    timeout = aiohttp.ClientTimeout(total=None)
    async with http.get(url, timeout=timeout, **how) as answer:
        answer.raise_for_status()
        length = 0
        async for line in answer.content:
            name, _, value = line.decode("ascii", "replace").partition(":")
            if name.lower() == "content-length":
                length = int(value)
            elif length and not line.strip():
                jpeg = await answer.content.readexactly(length)
                on_frame(Frame(time.time(), jpeg))
                length = 0
    raise ConnectionError("the stream ended")
