"""What the guard finds among operators' messages, what a command says, and how it is kept within limits."""

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_agent.guard.drive_messages import (
    GUARDED,
    MAX_STEP_S,
    SHAPES,
    CheckedCommand,
    DriveLimits,
    DriveMessageRefusedError,
    DriveMessageUnclearError,
    DriveTopics,
    drive_message,
    limited,
    message_id,
    read_command,
    write_command,
    zero,
)
from robotether_common.guard import MAX_NUMBER
from robotether_common.ros import MAX_GLOB_LENGTH

TOPICS = DriveTopics(["/cmd_vel", "*/cmd_vel"])


def test_a_relative_name_may_be_a_drive_topic_in_a_namespace():
    """Rosbridge in the namespace /base makes /base/vel of vel."""
    topics = DriveTopics(["/base/vel"])
    assert not topics.match("/vel")
    assert topics.might_be("vel")
    assert not topics.might_be("scan")


def test_patterns_are_names_with_stars():
    for wrong in ("/cmd[v]el", "/cmd?vel", "", "/cmd vel"):
        with pytest.raises(ValueError, match="not a name"):
            DriveTopics([wrong])
    with pytest.raises(ValueError, match="not a name"):
        DriveTopics(["/" * (MAX_GLOB_LENGTH + 1)])
    # The server takes as many; a robot that refused one would never connect.
    assert DriveTopics(["*" * MAX_GLOB_LENGTH]).match("/cmd_vel")
    assert TOPICS.plain() == ["/cmd_vel"]
    assert TOPICS.match("/a/b/cmd_vel")
    assert not TOPICS.match("/my_cmd_vel")
    assert not DriveTopics([]).match("/cmd_vel")


def read(data):
    return drive_message(data if isinstance(data, bytes) else json.dumps(data).encode(), TOPICS)


@pytest.mark.parametrize(
    "message",
    [
        {"op": "subscribe", "topic": "/cmd_vel"},
        {"op": "publish", "topic": "/chatter", "msg": {"data": "x"}},
        {"op": "call_service", "service": "/x", "args": {"op": "open"}},
        {"op": "set_level", "level": "none"},
        {"op": "subscribe", "topic": "~odd"},
        {"op": "a new operation"},
    ],
)
def test_what_does_not_drive_may_pass(message):
    assert read(message) is None


@pytest.mark.parametrize("operation", ["publish", "advertise", "unadvertise"])
@pytest.mark.parametrize("name", ["/cmd_vel", "cmd_vel", "/base/cmd_vel", "base/cmd_vel"])
def test_operations_on_drive_topics_are_found(operation, name):
    message = read({"op": operation, "topic": name, "msg": {}})
    assert (message.operation, message.topic) == (operation, "/" + name.lstrip("/"))


@pytest.mark.parametrize("operation", ["publish", "advertise", "unadvertise"])
def test_a_drive_command_for_what_is_no_drive_topic_here_is_refused(operation):
    """Settings change at the server first: what it stamped must not reach the wheels past the guard."""
    with pytest.raises(DriveMessageUnclearError, match="is a drive topic for the server"):
        read({"op": operation, "topic": "/base/move", "robotether": {"t_ms": 1.0, "fence": 13}})


def test_escapes_hide_no_operation():
    found = read(rb'{"\u006fp":"\u0070ublish","topic":"/cmd\u005fvel","msg":{}}')
    assert found.topic == "/cmd_vel"


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"null",
        b"[]",
        b"{}",
        b'{"op":3}',
        b'{"op":"publish","topic":"/cmd_vel"',
        b'{"op":"publish","topic":"/cmd_vel","msg":{}}}',
        b'{"op":"publish","op":"subscribe","topic":"/cmd_vel"}',
        b'{"op":"publish","topic":"/cmd_vel","topic":"/x"}',
        b'{"op":"subscribe","topic":"/x","a":{"op":"publish","topic":"/cmd_vel"}}',
        b'{"op":"publish","topic":"/x","msg":{"op":"publish","topic":"/cmd_vel"}}',
        b'{"op":"call_service","args":[NaN,{"op":"x"}]}',
        b'{"op":"publish","topic":"//cmd_vel"}',
        b'{"op":"publish","topic":"/x/../cmd_vel"}',
        b'{"op":"publish"}',
        b'{"op":"fragment","id":"1","data":"..."}',
        b'{"op":"png","data":"..."}',
        b"\xff{}",
        b"\xef\xbb\xbf{}",
        '{"op":"publish","topic":"/cmd_vel"}'.encode("utf-16"),
        b'{"op":"x","a":' + b"[" * 100_000,
        b'{"op":"x","a":' + b"1" * 5000 + b"}",
        # Reading it would delay a zero.
        b'{"op":"x","a":[' + b"{}," * 100_000 + b"0]}",
        b"\x15\x00\x00\x00\x02op\x00\x08\x00\x00\x00publish\x00\x00",
    ],
)  # fmt: skip
def test_what_cannot_be_checked_is_refused(data):
    with pytest.raises(DriveMessageUnclearError):
        read(data)


def test_an_id_is_a_short_text_or_a_number():
    """Nothing else goes back, and none goes on to rosbridge."""
    ids = ["a", 3, None, True, 1.5, {}, "x" * 1000]
    assert [message_id({"id": value}) for value in ids] == ["a", 3, None, None, None, None, None]


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=8) | st.sampled_from([*GUARDED, "/cmd_vel", "/x"]),
    lambda inner: st.lists(inner, max_size=3)
    | st.dictionaries(st.sampled_from(["op", "topic", "msg", "id", "x"]), inner, max_size=5),
    max_leaves=12,
)  # fmt: skip


def operations(value):
    if isinstance(value, dict):
        return [value[k] for k in value if k == "op"] + [
            x for v in value.values() for x in operations(v)
        ]
    return [x for v in value for x in operations(v)] if isinstance(value, list) else []


@given(JSON)
def test_nothing_that_passes_can_drive(value):
    try:
        passed = read(json.dumps(value).encode()) is None
    except DriveMessageUnclearError:
        return
    assert isinstance(value, dict)
    inner = operations(list(value.values()))
    assert not [op for op in inner if isinstance(op, str) and op in GUARDED]
    if passed and value["op"] in ("publish", "advertise", "unadvertise"):
        assert not TOPICS.match("/" + value["topic"].lstrip("/"))


TWIST = {
    "linear": {"x": 1.0, "y": 0.0, "z": 0.0},
    "angular": {"x": 0.0, "y": 0.0, "z": -0.5},
}
HEADER = {"frame_id": "base"}
DRIVE = {
    "steering_angle": 0.1,
    "speed": 2.0,
    "steering_angle_velocity": 0.0,
    "acceleration": 0.0,
    "jerk": 0.0,
}
SLACK = 1 + 1e-9

number = st.floats(-1e6, 1e6)
vector = st.tuples(number, number, number)
# Of a subnormal number the last digits are lost, far below any speed.
limit = st.none() | st.floats(0, 100, allow_subnormal=False)
limits = st.builds(DriveLimits, limit, limit, limit, limit, limit)
commands = st.builds(CheckedCommand, st.just("twist"), vector, vector, number)
step = st.floats(-1, 1e4)


@pytest.mark.parametrize(
    "message", [TWIST, {"header": HEADER, "twist": TWIST}, {"header": HEADER, "drive": DRIVE}]
)
def test_each_shape_comes_out_as_it_went_in(message):
    assert write_command(read_command(message, None)) == message


def test_the_advertised_type_decides_only_when_the_message_says_nothing():
    assert read_command({}, "ackermann").shape == "ackermann"
    assert read_command({"header": {}}, "twist_stamped").shape == "twist_stamped"
    assert read_command(TWIST, "ackermann").shape == "twist"
    with pytest.raises(DriveMessageRefusedError):
        read_command({}, None)


@pytest.mark.parametrize("stamp", ["now", {"secs": 2**40, "nsecs": 4}, {"sec": 2**40}])
@pytest.mark.parametrize("body", [{"twist": TWIST}, {"drive": DRIVE}])
def test_stamp_and_number_are_the_robots(stamp, body):
    """One of the other ROS would make a zero that the robot does not take, one to come a command without end."""
    message = {"header": {**HEADER, "stamp": stamp, "seq": 7}, **body}
    assert write_command(read_command(message, None)) == {"header": HEADER, **body}


@pytest.mark.parametrize(
    "message",
    [
        None, [], "x", {"linear": None}, {"linear": [1, 2]}, {"linear": {"x": "1"}}, {"linear": {"x": True}},
        {"linear": {"x": None}}, {"linear": {"x": float("nan")}}, {"linear": {"x": float("inf")}},
        {"linear": {"x": 10**400}}, {"linear": {"x": 1e10}}, {"linear": {"w": 1}}, {"linear": {}, "speed": 3},
        {"twist": 3}, {"twist": {}, "linear": {}}, {"drive": {"speed": "fast"}}, {"drive": {"gear": 1}},
        {"header": 3, "twist": {}}, {"header": {"x": 1}, "twist": {}}, {"header": {"frame_id": "x" * 300}, "twist": {}},
        {"header": {"frame_id": "\ud800"}, "twist": {}}, {"header": {"frame_id": "a\0"}, "twist": {}},
        {"header": {"stamp": {"sec": 1.5}}, "twist": {}}, {"header": {"stamp": {"op": 1}}, "twist": {}},
        {"header": {"seq": -1}, "twist": {}}, {"header": {"stamp": {"sec": 2**70}}, "twist": {}},
    ],
)  # fmt: skip
def test_anything_else_is_no_command(message):
    with pytest.raises(DriveMessageRefusedError) as refused:
        read_command(message, None)
    assert refused.value.kind == "shape"


@pytest.mark.parametrize("shape", sorted(set(SHAPES.values())))
def test_zero_stands_still(shape):
    """Its header names the frame and leaves the time to rosbridge."""
    command = zero(shape, "base")
    assert not command.moves
    written = write_command(command)
    assert written.get("header", {"frame_id": "base"}) == {"frame_id": "base"}
    assert read_command(written, None) == command


def test_turning_wheels_alone_is_no_motion():
    assert not read_command({"drive": {"steering_angle": 0.3}}, None).moves
    assert read_command({"drive": {"acceleration": 0.5}}, None).moves
    assert read_command({"drive": {"speed": -0.1}}, None).moves
    assert read_command({"angular": {"z": 0.1}}, None).moves


NUMBER = st.one_of(
    st.floats(), st.integers(), st.just(10**400), st.text(max_size=3), st.none(), st.booleans()
)
VECTOR = st.dictionaries(st.sampled_from(["x", "y", "z", "w"]), NUMBER, max_size=3)


@given(
    st.dictionaries(
        st.sampled_from(["linear", "angular", "twist", "header"]), VECTOR | NUMBER, max_size=3
    )
)
def test_whatever_passes_is_finite_and_json(message):
    try:
        command = read_command(message, None)
    except DriveMessageRefusedError:
        return
    numbers = (*command.linear, *command.angular, command.steering)
    assert all(-MAX_NUMBER <= number <= MAX_NUMBER for number in numbers)
    json.dumps(write_command(command), allow_nan=False)


def length(values):
    return math.hypot(*values)


def driven(speed):
    return CheckedCommand("twist", (speed, 0.0, 0.0))


@given(commands, st.none() | commands, step, limits)
def test_no_command_exceeds_a_limit(wanted, before, step_s, within):
    got = limited(wanted, before, step_s, within)
    if within.max_speed_m_s is not None:
        assert length(got.linear) <= within.max_speed_m_s * SLACK
    if within.max_turn_rad_s is not None:
        assert length(got.angular) <= within.max_turn_rad_s * SLACK
    if within.max_steering_rad is not None:
        assert abs(got.steering) <= within.max_steering_rad
    if within.max_acceleration_m_s2 is not None:
        had = length(before.linear) if before else 0.0
        assert (
            length(got.linear) <= (had + within.max_acceleration_m_s2 * MAX_STEP_S) * SLACK + 1e-9
        )


@given(commands, st.none() | commands, step, limits)
def test_a_command_only_becomes_slower_and_keeps_its_direction(wanted, before, step_s, within):
    """A limit never turns, speeds up or reverses a robot."""
    got = limited(wanted, before, step_s, within)
    for asked, given_ in zip(
        (*wanted.linear, *wanted.angular), (*got.linear, *got.angular), strict=True
    ):
        assert abs(given_) <= abs(asked) * SLACK
        assert asked * given_ >= 0


@given(vector, st.floats(0, 1), step, limits)
def test_braking_is_never_delayed(before, part, step_s, within):
    """Less of the same motion passes as it is, if the robot was within its speed."""
    x, y, z = before
    wanted = CheckedCommand("twist", (x * part, y * part, z * part), (x * part, y * part, z * part))
    growth = DriveLimits(
        None, None, within.max_acceleration_m_s2, within.max_turn_acceleration_rad_s2, None
    )
    got = limited(wanted, CheckedCommand("twist", before, before), step_s, growth)
    assert math.dist(got.linear, wanted.linear) <= length(wanted.linear) * 1e-9
    assert math.dist(got.angular, wanted.angular) <= length(wanted.angular) * 1e-9


@given(commands, step, limits)
def test_a_stop_is_a_stop(before, step_s, within):
    assert not limited(CheckedCommand("twist"), before, step_s, within).moves


@pytest.mark.parametrize(("wanted", "allowed"), [(9.0, 2.0), (-9.0, -2.0), (1.0, 1.0)])
def test_the_acceleration_that_a_car_is_told_is_limited(wanted, allowed):
    command = CheckedCommand("ackermann", rates=(0.5, wanted, 3.0))
    got = limited(command, None, 0.05, DriveLimits(max_acceleration_m_s2=2))
    assert got.rates == (0.5, allowed, 3.0)


def test_the_other_way_begins_at_a_standstill():
    """Full reverse brakes at once and then grows as from zero."""
    got = limited(driven(-5), driven(5), 0.05, DriveLimits(max_acceleration_m_s2=2))
    assert math.isclose(got.linear[0], -0.1)
