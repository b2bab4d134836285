"""What the encoder's process and its client send each other: a request, its answer, each after its length.

A frame goes there as the camera's JPEG and returns as one access unit, or with the reason why there is none.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from robotether_common.codecs import CODECS, Codec
from robotether_common.frames import MAX_DEPENDENT_FRAME_BYTES, MAX_FRAME_BYTES

from robotether_agent.problems import DetailError
from robotether_agent.video.av_messages import framed

# From the one that saves most bits to the one that takes least time.
PRESETS = ("veryfast", "superfast", "ultrafast")
# Maximum length of a name, or of the reason why there is no frame.
MAX_TEXT_BYTES = 200
_REQUEST = struct.Struct("!BBBHHdd")
_ANSWER = struct.Struct("!BBdB")
MAX_REQUEST_BYTES = _REQUEST.size + MAX_FRAME_BYTES
MAX_ANSWER_BYTES = _ANSWER.size + MAX_TEXT_BYTES + MAX_DEPENDENT_FRAME_BYTES
_KEY, _NO_HARDWARE = 1, 2
_FRAME, _REFUSED = 0, 1


class EncoderError(DetailError):
    """A frame is not encoded; the message says why."""


class FrameRefusedError(EncoderError):
    """The encoder cannot encode this frame, and goes on."""


@dataclass(frozen=True)
class EncodeRequest:
    """One frame and what is wanted of it.

    `width` and `height` are those of the encoded frame in pixels, both even and at least 16. `bits_per_s` at `fps`
    frames a second gives the size that frames have on average. `requests_key`: it can be shown without those before it.
    """

    jpeg: bytes
    codec: Codec
    width: int
    height: int
    bits_per_s: float
    fps: float
    preset: str = PRESETS[0]
    requests_key: bool = False
    allows_hardware: bool = True

    def packed(self) -> bytes:
        """Return the request as it is sent, with its length."""
        flags = (_KEY if self.requests_key else 0) | (0 if self.allows_hardware else _NO_HARDWARE)
        head = _REQUEST.pack(
            self.codec.number,
            PRESETS.index(self.preset),
            flags,
            self.width,
            self.height,
            self.bits_per_s,
            self.fps,
        )
        return framed(head + self.jpeg)

    @classmethod
    def unpacked(cls, data: bytes) -> EncodeRequest:
        """Return the request of a message without its length."""
        number, preset, flags, width, height, bits_per_s, fps = _REQUEST.unpack_from(data)
        return cls(
            jpeg=data[_REQUEST.size :],
            codec=CODECS[number],
            width=width,
            height=height,
            bits_per_s=bits_per_s,
            fps=fps,
            preset=PRESETS[preset],
            requests_key=bool(flags & _KEY),
            allows_hardware=not flags & _NO_HARDWARE,
        )


@dataclass(frozen=True)
class EncodedFrame:
    """One access unit; `took_s` is the time from the request to the answer, `encoder` the name of FFmpeg's encoder."""

    data: bytes
    is_key: bool
    encoder: str
    took_s: float

    def packed(self) -> bytes:
        """Return the answer as it is sent, with its length."""
        return _answer(_FRAME, self.encoder, self.data, is_key=self.is_key, took_s=self.took_s)


def refusal(reason: str) -> bytes:
    """Return the answer that there is no frame, and why, as it is sent."""
    return _answer(_REFUSED, reason, b"")


def unpacked_answer(data: bytes) -> EncodedFrame:
    """Return the frame of a message without its length; FrameRefusedError where there is none."""
    try:
        kind, is_key, took_s, length = _ANSWER.unpack_from(data)
        text = data[_ANSWER.size : _ANSWER.size + length].decode()
    except (struct.error, UnicodeDecodeError) as error:
        raise EncoderError("the encoder's answer makes no sense") from error
    if kind != _FRAME:
        raise FrameRefusedError(text)
    return EncodedFrame(data[_ANSWER.size + length :], bool(is_key), text, took_s)


def _answer(
    kind: int, text: str, data: bytes, *, is_key: bool = False, took_s: float = 0.0
) -> bytes:
    named = text.encode()[:MAX_TEXT_BYTES].decode(errors="ignore").encode()
    return framed(_ANSWER.pack(kind, is_key, took_s, len(named)) + named + data)
