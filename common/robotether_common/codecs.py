"""The codecs of video frames, as their number stands in a frame's header (docs/reference/media.md). One row each."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Codec:
    """One codec; `depends_on_earlier`: a frame can be shown only after those before it, back to a key frame."""

    number: int
    mime_type: str
    depends_on_earlier: bool


JPEG = Codec(1, "image/jpeg", depends_on_earlier=False)
CODECS = {codec.number: codec for codec in (JPEG,)}
