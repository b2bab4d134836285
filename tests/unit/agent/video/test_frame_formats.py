"""Frames as cameras write them: parts of a stream, raw images of ROS, and access units of H.264."""

import base64
from fractions import Fraction

import av
import numpy as np
import pytest
from robotether_agent.video import multipart
from robotether_agent.video.h264 import MAX_UNITS, access_unit
from robotether_agent.video.multipart import (
    MultipartBrokenError,
    MultipartParser,
    boundary_of,
)
from robotether_agent.video.newest_jpegs import CameraFailedError, JpegMaker
from robotether_agent.video.raw_images import FrameMaker, RawImage
from video_clips import clip, pixels_of

BODIES = [b"\xff\xd8one\r\n\xff\xd9", b"\xff\xd8two\n\n\xff\xd9"]
SERVER = b"--b\r\n" + b"".join(
    b"Content-type: image/jpeg\r\nX-Timestamp: 12.500000\r\nContent-Length: %d\r\n\r\n%s\r\n--b\r\n"
    % (len(body), body)
    for body in BODIES
)
NO_LENGTH = (
    b"".join(b"\r\n--b\r\nContent-Type: image/jpeg\r\n\r\n" + body for body in BODIES)
    + b"\r\n--b\r\n"
)
BARE_LF = b"".join(b"\n--b\nContent-Length: %d\n\n%s" % (len(body), body) for body in BODIES)


def in_pieces(stream, length):
    parts = MultipartParser(b"--b")
    pieces = (stream[at : at + length] for at in range(0, len(stream), length))
    return [part for piece in pieces for part in parts.feed(piece)]


@pytest.mark.parametrize("stream", [SERVER, NO_LENGTH, BARE_LF])
@pytest.mark.parametrize("length", [1, 7, 10_000])
def test_the_parts_of_a_stream(stream, length):
    assert [part.body for part in in_pieces(stream, length)] == BODIES


@pytest.mark.parametrize(
    "content_type",
    [
        "multipart/x-mixed-replace;boundary=b",
        'multipart/x-mixed-replace; boundary="--b"',
        "multipart/x-mixed-replace; boundary=--b",
    ],
)
def test_the_boundary_as_cameras_name_it(content_type):
    assert boundary_of(content_type) == b"--b"


def test_nothing_grows_without_bound(monkeypatch):
    monkeypatch.setattr(multipart, "MAX_FRAME_BYTES", 1000)
    for stream in (
        b"--b\r\nContent-Length: 1001\r\n\r\n",
        b"--b\r\nA: b\r\n\r\n" + bytes(2000),
        b"--b\r\n" + b"A: b\r\n" * 2000,
        b"\r\n" * 10_000,
    ):
        with pytest.raises(MultipartBrokenError):
            in_pieces(stream, 100)


ORANGE = (200, 100, 50)


def message(pixels, encoding, *, padding=0, big=False):
    ordered = pixels.byteswap() if big else pixels
    rows = [row.tobytes() + b"\7" * padding for row in ordered]
    return {
        "width": pixels.shape[1],
        "height": pixels.shape[0],
        "step": len(rows[0]),
        "encoding": encoding,
        "is_bigendian": int(big),
        "data": base64.b64encode(b"".join(rows)).decode(),
    }


def shown(image):
    return pixels_of(JpegMaker().jpeg(FrameMaker().frame(RawImage.of(image))))


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize(
    ("encoding", "pixel", "colour"),
    [
        ("rgb8", ORANGE, ORANGE),
        ("bgr8", ORANGE[::-1], ORANGE),
        ("rgba8", (*ORANGE, 9), ORANGE),
        ("bgra8", (*ORANGE[::-1], 9), ORANGE),
        ("mono8", 77, (77, 77, 77)),
        ("8UC1", 77, (77, 77, 77)),
        ("8UC3", ORANGE[::-1], ORANGE),
        ("8UC4", (*ORANGE[::-1], 9), ORANGE),
        # Two pixels of BT.601 in limited range each, and four under a filter each.
        ("yuv422", [[(90, 81), (240, 81)]], (255, 0, 0)),
        ("yuv422_yuy2", [[(81, 90), (81, 240)]], (255, 0, 0)),
        ("bayer_rggb8", [[200, 100], [100, 50]], ORANGE),
        ("bayer_grbg8", [[100, 200], [50, 100]], ORANGE),
    ],
)
def test_colours_are_shown_as_they_are(encoding, pixel, colour, padding):
    block = np.array(pixel, np.uint8)
    block = block if block.ndim > 1 else block.reshape(1, 1, -1)
    pixels = np.tile(block, (30 // block.shape[0], 50 // block.shape[1]) + (1,) * (block.ndim - 2))
    picture = shown(message(pixels, encoding, padding=padding))
    assert picture.shape == (30, 50, 3)
    assert np.abs(picture.astype(int) - colour).max() <= 4


NAN, INFINITE = float("nan"), float("inf")


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(
    ("encoding", "kind", "greys"),
    [
        ("mono16", np.uint16, {0: 0, 77 * 257: 77, 65535: 255}),
        # From white at 0 m to dark grey at 10 m and beyond; what is unknown is black.
        ("16UC1", np.uint16, {0: 0, 1: 255, 5000: 143, 10_000: 32, 65535: 32}),
        (
            "32FC1",
            np.float32,
            {0.0: 0, NAN: 0, -1.0: 0, 0.001: 255, 5.0: 143, 10.0: 32, 99.0: 32, INFINITE: 32},
        ),
    ],
)
def test_greys_of_more_bits(encoding, kind, greys, big):
    for value, grey in greys.items():
        picture = shown(message(np.full((16, 16), value, kind), encoding, padding=4, big=big))
        assert np.abs(picture.astype(int) - grey).max() <= 2, value


IMAGE = message(np.zeros((16, 16, 3), np.uint8), "rgb8")


@pytest.mark.parametrize(
    ("lie", "why"),
    [
        ({"encoding": "nv21"}, "the encoding nv21, which is not shown"),
        ({"height": 17}, "less data than their size"),
        ({"step": 1000}, "less data than their size"),
        ({"width": 7680}, "make no sense: field width must be a whole number from 1 to 4096"),
        ({"height": -1}, "make no sense"),
        ({"step": 47}, "make no sense"),
        ({"step": "48"}, "make no sense"),
        ({"data": [0] * 768}, "make no sense"),
        ({"data": "é"}, "make no sense"),
        ({"data": None}, "make no sense"),
    ],
)
def test_a_message_that_lies_is_refused(lie, why):
    with pytest.raises(CameraFailedError, match=why):
        RawImage.of(IMAGE | lie)


def encoded(**options):
    encoder = av.CodecContext.create("libx264", "w")
    encoder.width, encoder.height, encoder.pix_fmt = 320, 240, "yuv420p"
    encoder.time_base, encoder.gop_size = Fraction(1, 15), 8
    encoder.options = {"preset": "ultrafast", **options}
    packets = []
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
        assert read.has_slice == is_frame


def test_parameter_sets_alone_are_no_frame():
    unit = access_unit(b"\0\0\0\1\x67\1\2\0\0\1\x68\1")
    assert not unit.has_slice
