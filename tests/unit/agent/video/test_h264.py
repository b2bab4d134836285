"""Key frames, parameter sets and B frames, as a real encoder writes them."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import av
from robotether_agent.video.h264 import MAX_UNITS, access_unit
from video_clips import clip


def encoded(**options: str) -> list[tuple[bytes, Any]]:
    encoder: Any = av.CodecContext.create("libx264", "w")
    encoder.width, encoder.height, encoder.pix_fmt = 320, 240, "yuv420p"
    encoder.time_base, encoder.gop_size = Fraction(1, 15), 8
    encoder.options = {"preset": "ultrafast", **options}
    packets: list[Any] = []
    for number, picture in enumerate(clip(20, step=2)):
        frame = av.VideoFrame.from_ndarray(picture, "rgb24")
        frame.pts = number
        packets += encoder.encode(frame)
    packets += encoder.encode(None)
    return [(bytes(packet), packet) for packet in packets]


def test_frames_that_depend_on_later_ones_are_told():
    """A frame that is shown later than it is decoded is one."""
    packets = encoded(bf="2", **{"x264-params": "b-adapt=0"})
    units = [access_unit(data) for data, _ in packets]
    latest, later = -1, []
    for _, packet in packets:
        later.append(packet.pts < latest)
        latest = max(latest, packet.pts)
    assert [unit is not None and unit.is_bidirectional for unit in units] == later
    assert any(later)
    assert not any(
        unit is None or unit.is_bidirectional
        for unit in (access_unit(d) for d, _ in encoded(bf="0"))
    )


def test_only_what_a_frame_begins_with_is_read():
    """Else megabytes of start codes would hold up the agent until the guard takes it for dead."""
    unit, delimiter = b"\0\0\1\x65\x88", b"\0\0\1\x09\xf0"
    for count, is_frame in ((MAX_UNITS - 1, True), (MAX_UNITS, False)):
        read = access_unit(delimiter * count + unit)
        assert read is not None
        assert read.has_slice == is_frame


def test_parameter_sets_alone_are_no_frame():
    unit = access_unit(b"\0\0\0\1\x67\1\2\0\0\1\x68\1")
    assert unit is not None
    assert not unit.has_slice
