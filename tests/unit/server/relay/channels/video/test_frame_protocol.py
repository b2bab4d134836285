"""The frames protocol in bytes and texts."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_common.codecs import NAMES, decoded_by
from robotether_common.frames import (
    MAX_DEPENDENT_FRAME_BYTES,
    MAX_FRAME_BYTES,
    StreamRequest,
    VideoStatus,
)
from robotether_server.problems import ProtocolError
from robotether_server.relay.channels.video.frame_protocol import (
    SenderClock,
    combined,
    parse_clock_sync_answer,
    parse_credit,
    parse_frame,
    parse_status,
    parse_stream_request,
    parse_text,
    pixels,
)

JPEG = b"\xff\xd8 a picture \xff\xd9"


def sent(sequence=5, timestamp_ms=1234.5, codec=1, jpeg=JPEG):
    return struct.pack("!BBHId", codec, 1, 70, sequence, timestamp_ms) + jpeg


@pytest.mark.parametrize(
    "data",
    [b"", sent(jpeg=b""), sent(timestamp_ms=math.nan), sent(timestamp_ms=math.inf),
     sent(timestamp_ms=1e300), sent(jpeg=b"x" * (MAX_FRAME_BYTES + 1)),
     sent(codec=2, jpeg=b"x" * (MAX_DEPENDENT_FRAME_BYTES + 1))],
    ids=["empty", "header only", "nan", "infinite", "far away", "too large", "too large to hold"],
)  # fmt: skip
def test_what_is_no_frame_is_refused(data):
    with pytest.raises(ProtocolError):
        parse_frame(data)


@pytest.mark.parametrize(
    ("codecs", "expected"),
    [(["vp8", "h264"], NAMES), (["av1", "h264", "h264"], ("h264", "jpeg")), ([], ("jpeg",)),
     (["x"] * 10_000, ("jpeg",)), ("h264", ("jpeg",)), ({"h264": 1}, ("jpeg",)),
     ([["h264"], None, 7], ("jpeg",)), (None, ("jpeg",))],
    ids=repr,
)  # fmt: skip
def test_codecs_of_a_request_are_those_that_are_known(codecs, expected):
    assert parse_stream_request({"codecs": codecs}).codecs == expected


@pytest.mark.parametrize(
    ("parse", "message"),
    [
        *((parse_text, data) for data in (b"[]", b"\xff", b"[" * 4000, b'{"op": "x' + b"x" * 4096)),
        *((parse_stream_request, {"fps": fps}) for fps in (0, math.nan, 61)),
        *((parse_stream_request, {"quality_max": quality}) for quality in (101, 50.5, True)),
        *((parse_stream_request, {"latency_ms": latency_ms}) for latency_ms in (49, 5001)),
        *((parse_credit, {"taken": sequence}) for sequence in (-1, 2**32)),
        *((parse_clock_sync_answer, {"t_ms": 1, "sender_ms": sender}) for sender in (None, math.nan)),
    ],
)  # fmt: skip
def test_what_is_out_of_bounds_is_refused(parse, message):
    """The transcript of viewers' ends has one of each other kind."""
    with pytest.raises(ProtocolError):
        parse(message)


WANTS = st.builds(
    lambda low, more, fps, latency, size, codecs, prefers: StreamRequest(
        low, low + more, fps, latency, *size, codecs=decoded_by(codecs), prefers=prefers
    ),
    st.integers(1, 50),
    st.integers(0, 50),
    st.floats(0.1, 60),
    st.floats(50, 5000),
    st.sampled_from([(None, None), (320, 240), (640, 480), (4096, 4096)]),
    st.lists(st.sampled_from(NAMES)),
    st.sampled_from([None, "sharp", "smooth"]),
)


@given(WANTS, WANTS)
def test_what_two_want_together_serves_both(request, other):
    both = combined(request, other)
    assert both == combined(other, request)
    assert both.quality_max == max(request.quality_max, other.quality_max)
    assert both.quality_min == min(request.quality_min, other.quality_min)
    assert both.fps == max(request.fps, other.fps)
    assert both.latency_ms == min(request.latency_ms, other.latency_ms)
    assert set(both.codecs) == set(request.codecs) & set(other.codecs)
    assert both.codecs == decoded_by(both.codecs)
    preferences = {request.prefers, other.prefers} - {None}
    expected = preferences if len(preferences) < 2 else {"smooth"}
    assert both.prefers == next(iter(expected), None)
    assert pixels(both) == max(pixels(request), pixels(other))
    assert (both.width, both.height) in {
        (request.width, request.height),
        (other.width, other.height),
    }


def test_a_status_keeps_what_viewers_know():
    status = parse_status(
        {"op": "status", "state": "down", "detail": "no\nanswer", "source": "evil", "fps": math.nan}
        | {"quality": 70, "width": 640, "height": 1e9, "more": "x"}
        | {"codec": "av1", "encoder": ["libx264"], "no_encoder": {"why": "x"}}
    )
    assert status == VideoStatus("down", "no answer", quality=70, width=640)
    encoded = {"codec": "h264", "encoder": "lib\x1b" + "x" * 500, "no_encoder": "a\n" + "b" * 500}
    status = parse_status({"state": "live"} | encoded)
    assert (status.codec, status.encoder) == ("h264", "lib " + "x" * 36)
    assert status.no_encoder == "a " + "b" * 198
    for message in ({}, {"state": "fine"}, {"state": ["live"]}, {"state": "live", "detail": 5}):
        with pytest.raises(ProtocolError):
            parse_status(message)


@given(
    st.floats(-1e9, 1e9),
    st.lists(st.tuples(st.floats(0, 300), st.floats(0, 300)), min_size=1, max_size=20),
    st.floats(0, 1000),
)
def test_a_frames_timestamp_is_never_later_than_it_was(ahead_ms, travels, age_ms):
    clock, now_ms = SenderClock(), 10_000.0
    for there_ms, back_ms in travels:
        asked_ms = now_ms
        now_ms += there_ms + back_ms
        clock.on_answer(now_ms / 1000, asked_ms, asked_ms + there_ms + ahead_ms)
    ours_s = clock.ours(now_ms / 1000, now_ms - age_ms + ahead_ms)
    assert ours_s is not None
    assert ours_s * 1000 <= now_ms - age_ms + 1e-3
    assert now_ms - age_ms - ours_s * 1000 <= max(there for there, _ in travels) + 1e-3


def test_the_best_clock_sync_of_the_last_half_minute_counts():
    """A quick clock sync keeps the timestamp true, and is forgotten after 30 s: clocks drift."""
    clock = SenderClock()
    assert clock.ours(0.0, 5.0) is None
    clock.on_answer(1.0, 1000, 1000 + 2)
    clock.on_answer(2.0, 2000, 2000 + 500)
    assert clock.ours(2.0, 1500 + 2) == pytest.approx(1.5)
    clock.on_answer(31.5, 31_400, 31_400 + 40)
    assert clock.ours(31.5, 1500 + 40) == pytest.approx(1.5)
