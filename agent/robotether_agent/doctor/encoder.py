"""Checks which encoder this robot's video would have, by the encoding of a frame."""

from __future__ import annotations

import asyncio
import base64
from contextlib import suppress

from robotether_common.codecs import H264

from robotether_agent.doctor import Finding, ok, skipped, warning
from robotether_agent.settings import Settings
from robotether_agent.tasks import within
from robotether_agent.video.encoder import VideoEncoder, availability
from robotether_agent.video.encoder_messages import EncodedFrame, EncodeRequest, EncoderError

# Time limit for the encoder's start and a frame; its process imports FFmpeg first.
TIMEOUT_S = 30.0
# A grey JPEG of 16x16 pixels, as a frame of 640x480 at 15 frames and 500 kbit a second.
GREY = base64.b64decode(
    "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDAFA3PEY8MlBGQUZaVVBfeMiCeG5uePWvuZHI//////////////////////////////////"
    "//////////////////wAALCAAQABABAREA/8QAFAABAAAAAAAAAAAAAAAAAAAAAP/EABQQAQAAAAAAAAAAAAAAAAAAAAD/2gAIAQEA"
    "AD8AAP/Z"
)
TRIAL = EncodeRequest(GREY, H264, 640, 480, bits_per_s=500_000, fps=15, requests_key=True)


async def check_encoder(settings: Settings) -> Finding:
    """Whether this robot can send H.264; one that cannot works, too."""
    step = "encoder"
    if reason := availability(settings.video_encoder):
        return skipped(step, f"none, so video is JPEG: {reason}")
    try:
        frame = await within(TIMEOUT_S, _encode())
    except (EncoderError, OSError, asyncio.TimeoutError) as error:
        reason = str(error) or f"no frame within {TIMEOUT_S:g} s"
        advice = "journalctl -u robotether-agent may say more; docs/howto/video.md"
        return warning(step, f"none, so video is JPEG: {reason}", advice)
    return ok(
        step, f"{frame.encoder} encodes H.264, a frame of 640x480 in {frame.took_s * 1000:.0f} ms"
    )


async def _encode() -> EncodedFrame:
    has_changed = asyncio.Event()
    encoder = VideoEncoder(has_changed.set, "the doctor's frame")
    running = asyncio.ensure_future(encoder.run())
    try:
        # It has started, or says why not.
        await has_changed.wait()
        if not encoder.down_reason:
            with suppress(EncoderError):
                return await encoder.encode(TRIAL)
            # The driver of an encoder in hardware may be what failed: the next process does without.
            while encoder.down_reason:
                has_changed.clear()
                await has_changed.wait()
        return await encoder.encode(TRIAL)
    finally:
        running.cancel()
        with suppress(asyncio.CancelledError):
            await running
