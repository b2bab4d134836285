"""What a client's message may hold: JSON that all parsers read alike, and fields of the types that are listed."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_common.guard import MAX_SEEN_FRAMES
from robotether_server.relay.channels.rosbridge import operations
from robotether_server.relay.channels.rosbridge.drive_path import DriveStamp
from robotether_server.relay.channels.rosbridge.operations import (
    MAX_DEPTH,
    MAX_TEXT_LENGTH,
    FieldRefusedError,
    NotJsonError,
    read_json,
    write_json,
)
from robotether_server.relay.robots.delivered_frames import NamedFrame


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "truncated"),
        (b"{'a': 1}", "keys must be strings"),
        (b'{"a": 1} {"b": 2}', "trailing characters"),
        (b'\xef\xbb\xbf{"a": 1}', "invalid character"),
        (b'{"a": "\xed\xa0\x80"}', "not UTF-8"),
        (b'{"a": "\xc0\xaf"}', "not UTF-8"),
        (b'{"a": "\n"}', "invalid character"),
        (b'{"a": "\\ud800"}', "truncated"),
        (b'{"a": "\\ud800\\u0041"}', "surrogate"),
        (b'{"\\udfff": 1}', "surrogate"),
        (b"[{}]", "not an object"),
        (b'"{}"', "not an object"),
        (b'{"a": NaN}', "invalid character"),
        (b'{"a": -Infinity}', "invalid character"),
        (b'{"a": [1e999]}', "too large"),
        (b'{"a": 18446744073709551616}', "64 bits"),
        (b'{"a": -9223372036854775809}', "64 bits"),
        (b'{"a": [{"b": 1e-7, "c": [18446744073709551616]}]}', "64 bits"),
        (b'{"a": ' + b"9" * 100_000 + b"}", "too large"),
        (b'{"a": ' + b"[" * MAX_DEPTH + b"]" * MAX_DEPTH + b"}", "nested more than"),
        (b'{"a":' * 100_000 + b"1" + b"}" * 100_000, "nested too deep"),
    ],
)
def test_what_some_parser_refuses_is_not_read(data, why):
    with pytest.raises(NotJsonError, match=why):
        read_json(data)


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
        max_leaves=20,
    )
)
def test_what_is_read_and_written_stays_the_same(value):
    try:
        message = read_json(json.dumps({"a": value}).encode())
    except NotJsonError:
        return
    # 1 and 1.0, 0.0 and -0.0 are equal, but not the same.
    assert repr(message) == repr({"a": value})
    for same in (read_json(write_json(message)), json.loads(write_json(message))):
        assert repr(same) == repr(message)


NO_NUMBERS = [-1, 10, True, "1", None]


@pytest.mark.parametrize(
    ("check", "passes", "refused"),
    [
        (operations.text, ["", "/pose", "ü\n\0", "x" * MAX_TEXT_LENGTH],
         [None, 1, ["a"], {}, "x" * (MAX_TEXT_LENGTH + 1)]),
        (operations.whole(0, 9), [0, 9], [*NO_NUMBERS, 1.0]),
        (operations.clamped(0, 9), [0, 9], ["1", None, [], {}]),
        (operations.choice("a", "b"), ["b"], ["C", "a ", None, 1, ["a"], {}]),
        (operations.identity, ["x1", 7, -(2**63), 2**63 - 1], [2**63, 1.5, True, None, [], {}]),
        # No inner object, no member `op`, no number that parsers disagree on.
        (operations.scalars,
         [{}, [], ["a", 1, None], {"topic": "/a", "depth": 5, "x": 1.5, "y": True, "z": None}],
         [None, "text", {"a": {}}, {"a": []}, [[]], [{}], {"op": "publish"}, {"": 1}, {"a b": 1},
          {"a\n": 1}, {"x": 2**63}]),
        (operations.quality, [{}, {"depth": 1, "deadline": {"secs": 1, "nsecs": 0}}],
         [None, [], "a", {"a": []}, {"a": {"b": {}}}, {"a": {"b": []}}, {"op": 1}, {"op": {}},
          {"a": {"op": 1}}]),
        (operations.served_name, ["/a/b"], ["a/b", "//a", None]),
        (operations.flag, [True, False], [0, 1, "true", None]),
        (operations.members, [{}, {"op": {"x": [1]}}], [[], "x", 1, None]),
        (operations.payload, [{}, [], [{"op": 1}]], ["x", 1, None]),
        (operations.timestamp, [0, -1.5, 2**53],
         [2**60, True, "1", None, float("nan"), float("inf")]),
    ],
)  # fmt: skip
def test_each_type_passes_as_it_is(check, passes, refused):
    assert [check(value) for value in passes] == passes
    for value in refused:
        with pytest.raises(FieldRefusedError):
            check(value)


def test_a_number_out_of_range_is_the_nearest_in_it():
    """A program whose messages are refused for their queue, which rosbridge would take, sees nothing of it."""
    check, exact = operations.clamped(0, 9), operations.clamped(-9, 9, float)
    assert [check(value) for value in (-5, 10**400, 3.4, -1e300, True)] == [0, 9, 3, 0, 1]
    assert [exact(value) for value in (1.5, 10**400)] == [1.5, 9.0]


NAMED = {"camera": "/a", "frame": 1}
NO_SEEN_FRAMES = [
    *(None, {}, "/a", [1], [{"camera": "/a"}], [{"frame": 1}], [NAMED | {"camera": 1}]),
    *([NAMED | {"frame": frame}] for frame in (-1, 2**32, True, 1.5)),
    [NAMED] * (MAX_SEEN_FRAMES + 1),
]


def test_a_stamp_is_a_timestamp_and_what_was_seen():
    assert operations.stamp({"t_ms": 12, "fence": 3}) == DriveStamp(12.0)
    view = {"camera": "/a", "frame": 2**32 - 1, "taken_ms": 5}
    seen = (NamedFrame("/a", 2**32 - 1), NamedFrame("/b", None))
    assert operations.stamp(
        {"t_ms": 12, "seen": [view, {"camera": "/b", "frame": None}]}
    ) == DriveStamp(12.0, seen)
    assert operations.stamp({"seen": []}) == DriveStamp(None, ())
    wrong = [{"t_ms": 1, "seen": seen} for seen in NO_SEEN_FRAMES]
    for value in (None, 12, {}, {"t_ms": None}, {"t_ms": float("nan")}, [{"t_ms": 1}], *wrong):
        with pytest.raises(FieldRefusedError):
            operations.stamp(value)


TWIST = {"linear": {"x": 3, "y": 4.0, "z": 0}, "angular": {"x": 0, "y": 0, "z": -2}}


@pytest.mark.parametrize(
    ("msg", "speed", "turn"),
    [
        (TWIST, 5.0, 2.0),
        ({"linear": {"x": -1}}, 1.0, 0.0),
        ({"angular": {}}, 0.0, 0.0),
        ({}, 0.0, 0.0),
        ({"header": {"frame_id": "base"}, "twist": TWIST}, 5.0, 2.0),
        ({"header": {}}, 0.0, 0.0),
        ({"drive": {"speed": -1.5, "steering_angle": 0.3}}, 1.5, None),
        ({"header": {}, "drive": {}}, 0.0, None),
    ],
)
def test_each_shape_has_its_speeds(msg, speed, turn):
    assert operations.speeds(msg) == (speed, turn)


@pytest.mark.parametrize(
    "msg",
    [
        {"data": 1},
        {"twist": TWIST, "drive": {}},
        {"twist": {"linear": {}, "header": {}}},
        *({"linear": linear} for linear in (None, [1, 2, 3], {"x": 1, "w": 1})),
        *({"linear": {"x": x}} for x in (None, True, "1", float("inf"), -1e10)),
        {"linear": {"x": 1.7e308, "y": 1.7e308}},
        *({"drive": drive} for drive in (1, {"velocity": 1}, {"speed": None})),
        {"drive": {"speed": 1, "jerk": 1e300}},
    ],
)
def test_what_is_no_command_is_refused(msg):
    with pytest.raises(FieldRefusedError):
        operations.speeds(msg)
