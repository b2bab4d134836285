"""The codecs of video frames, as their number stands in a frame's header (docs/reference/media.md). One row each."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Codec:
    """One codec; `depends_on_earlier`: a frame can be shown only after all those since a key frame."""

    number: int
    name: str
    mime_type: str
    depends_on_earlier: bool


JPEG = Codec(1, "jpeg", "image/jpeg", depends_on_earlier=False)
# Annex B, one access unit a frame; key frames begin with their parameter sets.
H264 = Codec(2, "h264", "video/h264", depends_on_earlier=True)
VP8 = Codec(3, "vp8", "video/vp8", depends_on_earlier=True)
# In the order in which they are chosen where a viewer decodes several.
CODECS = {codec.number: codec for codec in (H264, VP8, JPEG)}
NAMES = tuple(codec.name for codec in CODECS.values())


def decoded_by(names: object) -> tuple[str, ...]:
    """Return the known codecs among the names that somebody sent, in our order; everybody decodes JPEG."""
    sent = names if isinstance(names, list | tuple) else ()
    return tuple(name for name in NAMES if name in sent or name == JPEG.name)
