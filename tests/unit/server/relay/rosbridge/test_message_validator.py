"""Which operations pass for which level, and what of them, and nothing beside in any spelling.

Long, as each module has one file of tests (test_structure.py).
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robotether_common.ros import Globs
from robotether_server.relay.drives.drive_path import stamped
from robotether_server.relay.rosbridge.message_validator import (
    ANSWERS_PER_S,
    MessageRefusedError,
    MessageValidator,
    Subscriptions,
    ValidatedMessage,
    status_error,
)
from robotether_server.relay.rosbridge.operations import OPERATIONS, ROSAPI_LOOKUPS_OF_DRIVERS
from robotether_server.robot_settings import DEFAULTS, LevelPolicy, Limits
from robotether_server.schemas import Level
from validators import DRIVING, MANAGING, OBSERVING, Clock, check, name_of, refused, sent, validator

DRIVE_TOPICS = Globs(["/cmd_vel", "*/cmd_vel"])


RIGHTS_OF = {
    "subscribe": "subscribe unsubscribe",
    "publish": "advertise unadvertise publish",
    "call": "call_service send_action_goal cancel_action_goal",
    "serve": "advertise_service unadvertise_service service_response advertise_action unadvertise_action "
    "action_feedback action_result action_status",
    None: "status set_level robotether.beat robotether.stop",
}


def test_each_operation_needs_its_right():
    """And there is no other operation."""
    rights = {name: right for right, names in RIGHTS_OF.items() for name in names.split()}
    assert {name: entry.right for name, entry in OPERATIONS.items()} == rights


@pytest.mark.parametrize("name", OPERATIONS)
def test_what_has_a_right_has_a_name(name):
    """Each operation is checked against a right by a field of its own, or concerns nobody."""
    entry = OPERATIONS[name]
    assert (entry.right is None) == (entry.named_by is None)
    assert entry.named_by is None or entry.named_by in entry.fields
    assert entry.own == name.startswith("robotether.")
    assert entry.checks == tuple(entry.fields.items())


def test_look_ups_write_nothing():
    """A name that says that it changes something has no place among them."""
    writing = re.compile("set|delete|add|remove|load|call|publish_|kill|write")
    assert [name for name in ROSAPI_LOOKUPS_OF_DRIVERS if writing.search(name)] == []


@pytest.mark.parametrize("level", ["observe", "drive", "manage"])
@pytest.mark.parametrize("message", OBSERVING, ids=name_of)
def test_everybody_may_send_what_only_looks(message, level):
    """Operations that change nothing on the robot pass with all their fields."""
    assert sent(message, validator(level)) == message


@pytest.mark.parametrize("message", DRIVING, ids=name_of)
def test_a_driver_publishes_on_drive_topics(message):
    """They need not stand in the policy; an observer sends none of it."""
    for level in ("drive", "manage"):
        assert sent(message, validator(level)) == message
    kind, answer = refused({**message, "id": "x1"}, validator())
    assert (kind, answer["op"], answer["level"], answer["id"]) == ("topic", "status", "error", "x1")
    assert "an observing connection only subscribes" in str(answer["msg"])


@pytest.mark.parametrize("message", MANAGING, ids=name_of)
def test_a_manager_sends_all(message):
    """What managers may do by default, drivers may not unless the policy says so."""
    assert sent(message, validator("manage")) == message
    kind, answer = refused(message, validator("drive"))
    assert kind == ("topic" if "topic" in message else "service")
    assert "the robot's policy does not let you" in str(answer["msg"])


def test_the_policy_says_which_names():
    """Globs of the level decide, and nothing else."""
    settings = {
        "policy": {
            "observe": {"subscribe": ["/pose", "/camera/*"]},
            "drive": {"publish": ["/lights"], "call": ["/dock", "/arm/*"]},
        }
    }
    observer, driver = validator("observe", settings), validator("drive", settings)
    for topic, passes in {
        "/pose": True,
        "/camera/a/b": True,
        "/secret": False,
        "/posex": False,
    }.items():
        if passes:
            sent({"op": "subscribe", "topic": topic}, observer)
        else:
            _, answer = refused({"op": "subscribe", "topic": topic}, observer)
            assert str(answer["msg"]).startswith(f"cannot subscribe to {topic}: the robot's policy")
    sent({"op": "publish", "topic": "/lights", "msg": {}}, driver)
    sent({"op": "call_service", "service": "/arm/up"}, driver)
    sent({"op": "send_action_goal", "action": "/dock"}, driver)
    assert refused({"op": "publish", "topic": "/lights/x", "msg": {}}, driver)[0] == "topic"
    assert refused({"op": "call_service", "service": "/reset"}, driver)[0] == "service"
    assert refused({"op": "advertise_service", "service": "/dock"}, driver)[0] == "service"


@pytest.mark.parametrize(
    ("name", "meant"),
    [("pose", "/pose"), ("/pose", "/pose"), ("a/b_1", "/a/b_1"), ("/_hidden/1", "/_hidden/1")],
)
def test_a_missing_first_slash_is_added(name, meant):
    """The robot gets the full name that was checked."""
    assert sent({"op": "subscribe", "topic": name}, validator()) == {
        "op": "subscribe",
        "topic": meant,
    }


@pytest.mark.parametrize(
    "name",
    ["", "/", "~pose", "~/pose", "/a//b", "//a", "/a/", "/a b", "/a\n", "/a/../b", "/ä", "/a#1",
     "/" + "a" * 255, 7, None, ["/a"], {"a": 1}, "/a\x00", "{ns}/a", "/a/~b"],
)  # fmt: skip
def test_no_other_spelling_of_a_name_passes(name):
    """The robot could read another name in it; so says the refusal."""
    for level in ("observe", "manage"):
        kind, answer = refused({"op": "subscribe", "topic": name}, validator(level))
        assert kind == "shape"
        assert "its field topic is no full name" in str(answer["msg"])


@pytest.mark.parametrize(
    "operation", ["fragment", "png", "auth", "unheard_of", "Publish", "", None, 7, ["publish"]]
)
@pytest.mark.parametrize("level", ["observe", "drive", "manage"])
def test_nobody_sends_an_unknown_operation(operation, level):
    """What hides something, and what is not in the list, does not pass."""
    kind, answer = refused(
        {"op": operation, "id": 3, "data": '{"op": "publish"}'}, validator(level)
    )
    assert (kind, answer["id"]) == ("operation", 3)
    assert str(answer["msg"]).startswith("cannot pass ")


@pytest.mark.parametrize("message", [*OBSERVING, *DRIVING, *MANAGING], ids=name_of)
def test_only_known_fields_go_on(message):
    """What rosbridge takes from any message, and what nobody knows, is left out."""
    more = {"message_intervall": 3600, "png": "png", "msgs": {"op": "publish"}, "x": [[[]]]}
    assert sent({**more, **message}, validator("manage")) == message


@pytest.mark.parametrize("message", OBSERVING + DRIVING + MANAGING, ids=name_of)
def test_a_field_of_another_type_is_named(message):
    """The refusal tells which field it was."""
    for name in message.keys() - {"op"}:
        wrong: object = 7.5 if name in {"args", "msg", "values"} else {"a": {"op": "publish"}}
        kind, answer = refused({**message, name: wrong}, validator("manage"))
        assert kind == "shape"
        assert str(answer["msg"]).startswith(f"cannot pass {message['op']}: its field {name} ")


@pytest.mark.parametrize(
    "operation", [name for name, entry in OPERATIONS.items() if entry.named_by is not None]
)
def test_the_field_that_says_what_is_needed(operation):
    """Without topic, service or action there is nothing to check."""
    assert refused({"op": operation}, validator("manage"))[0] == "shape"


def test_a_field_that_is_null_counts_as_absent():
    """Clients write null for what they do not want."""
    message = {"op": "subscribe", "topic": "/pose", "type": None, "compression": None}
    assert sent(message, validator()) == {"op": "subscribe", "topic": "/pose"}


@pytest.mark.parametrize(
    ("service", "levels"),
    [
        ("/rosapi/topics", {"observe", "drive"}),
        ("rosapi/topics", {"observe", "drive"}),
        ("/rosapi/topic_type", {"observe", "drive"}),
        ("/rosapi/get_time", {"observe", "drive"}),
        ("/rosapi/get_param", {"drive"}),
        ("/rosapi/get_param_names", {"drive"}),
        ("/rosapi/service_type", {"drive"}),
        ("/rosapi/set_param", set()),
        ("/rosapi/delete_param", set()),
        ("/rosapi/set_logger_level", set()),
        ("/rosapi/set_parameters", set()),
        ("/rosapi/unheard_of", set()),
        ("/rosapix/topics", set()),
        ("/robot/rosapi/topics", set()),
    ],
)
@pytest.mark.parametrize("level", ["observe", "drive"])
def test_who_may_call_nothing_calls_look_ups(service, levels, level):
    """An observer's look-ups ask no other node, which may hang; services that write, and unknown ones, are refused."""
    message = {"op": "call_service", "service": service}
    if level in levels:
        assert sent(message, validator(level)) == {
            **message,
            "service": "/rosapi/" + service.rsplit("/")[-1],
        }
    else:
        assert refused(message, validator(level))[0] == "service"


def test_a_look_up_takes_plain_values():
    """An observer sends no object inside another, in which an operation might hide."""
    for args in ({"a": {}}, [[]], {"op": "publish"}, [{"op": "publish"}]):
        message = {"op": "call_service", "service": "/rosapi/topics", "args": args}
        assert refused(message, validator())[0] == "shape"
        assert sent(message, validator("manage")) == message


def test_subscriptions_are_counted():
    """Up to the robot's limit; the same one again, and one that was given up, count nothing."""
    at = validator("observe", {"policy": {"limits": {"subscriptions": 2}}})
    sent({"op": "subscribe", "topic": "/a", "id": "1"}, at)
    sent({"op": "subscribe", "topic": "a", "id": "1"}, at)
    sent({"op": "subscribe", "topic": "/a", "id": "2"}, at)
    kind, answer = refused({"op": "subscribe", "topic": "/b", "id": "3"}, at)
    assert kind == "subscriptions"
    assert "has 2 subscriptions" in str(answer["msg"])
    sent({"op": "unsubscribe", "topic": "/a"}, at)
    sent({"op": "subscribe", "topic": "/b", "id": "3"}, at)


@pytest.mark.parametrize(("level", "per_s"), [("drive", 50), ("observe", 5)])
def test_the_rate_has_a_limit(level, per_s):
    """A second's worth passes at once, then as many as the rate gives; an observer has a tenth."""
    clock = Clock()
    limits = {"messages_per_s": 50, "message_kb": 4}
    at = validator(level, {"policy": {"limits": limits}}, clock)
    message = {"op": "subscribe", "topic": "/a"}
    for _ in range(per_s):
        sent(message, at)
    assert refused(message, at)[0] == "rate"
    clock.now += 0.2
    for _ in range(per_s // 5):
        sent(message, at)
    assert refused(message, at)[0] == "rate"


def test_a_large_message_counts_as_many():
    """Reading it holds up others as long as many small ones; the largest text always passes."""
    limits = {"messages_per_s": 50, "message_kb": 100}
    at = validator("manage", {"policy": {"limits": limits}})
    large = {"op": "publish", "topic": "/a", "msg": {"data": "x" * 102_000}}
    sent(large, at)
    assert refused(large, at)[0] == "rate"
    kind, answer = refused({**large, "msg": {"data": "x" * 102_400}}, at)
    assert (kind, "over 100 KB" in str(answer["msg"])) == ("size", True)


def test_many_values_count_more_than_a_text():
    """A message of nothing but brackets takes longest to read, and has a bound of its own."""
    at = validator("manage", {"policy": {"limits": {"messages_per_s": 50, "message_kb": 100}}})
    sent({"op": "publish", "topic": "/a", "msg": {"data": [1.5] * 3000}}, at)
    assert refused({"op": "publish", "topic": "/a", "msg": {"data": [1.5] * 3000}}, at)[0] == "rate"
    kind, answer = refused({"op": "publish", "topic": "/a", "msg": {"data": [{}] * 10_000}}, at)
    assert (kind, "too many values" in str(answer["msg"])) == ("size", True)


def test_a_stop_passes_at_any_rate():
    """Who floods the relay can still stop the robot."""
    at = validator("observe", {"policy": {"limits": {"messages_per_s": 1, "message_kb": 1}}})
    for _ in range(2):
        sent({"op": "subscribe", "topic": "/a"}, at)
    assert refused({"op": "subscribe", "topic": "/a"}, at)[0] == "rate"
    assert check({"op": "robotether.stop"}, at) == ValidatedMessage(
        b"", "robotether.stop", own={"op": "robotether.stop"}
    )


def test_the_word_for_a_stop_opens_nothing_else():
    """What only names it, in an id or a text, is held to the rate as everything else is."""
    at = validator("observe", {"policy": {"limits": {"messages_per_s": 1, "message_kb": 1}}})
    for _ in range(2):
        sent({"op": "subscribe", "topic": "/a"}, at)
    for message in (
        {"op": "subscribe", "topic": "/a", "id": "robotether.stop"},
        {"op": "status", "msg": "robotether.stop"},
    ):
        assert refused(message, at)[0] == "rate"
    assert check({"op": "robotether.stop"}, at).operation == "robotether.stop"


SMALL, LARGE = b'{"op":"subscribe","topic":"/a"}', b" " * 100_000
STOP = b'{"op":"robotether.stop"}'


def floods(at: MessageValidator, data: bytes) -> bool:
    """Send a message; tell whether it is one too many."""
    try:
        at.check(data)
    except MessageRefusedError as refusal:
        return refusal.floods
    return False


def seconds_until_closed(data: bytes, per_s: int, *, within_s: int = 30) -> float | None:
    """Send so many messages a second through an observer's validator of 200 a second; None: it is never closed."""
    clock = Clock()
    at = validator(clock=clock, settings={"policy": {"limits": {"message_kb": 1}}})
    for count in range(per_s * within_s):
        clock.now = 1000.0 + count / per_s
        if floods(at, data):
            return clock.now - 1000.0
    return None


@pytest.mark.parametrize(("data", "per_s"), [(SMALL, 1000), (SMALL, 20_000), (LARGE, 50)])
def test_who_goes_on_sending_too_much_is_closed(data, per_s):
    """Each refusal costs the relay time, so it does not go on refusing for ever."""
    closed_after_s = seconds_until_closed(data, per_s)
    assert closed_after_s is not None
    assert 3 <= closed_after_s <= 6


@pytest.mark.parametrize(("data", "per_s"), [(SMALL, 190), (SMALL, 300), (STOP, 2000), (LARGE, 1)])
def test_who_sends_a_little_too_much_or_stops_is_not(data, per_s):
    """Such messages are refused one by one; a stop is not even that."""
    assert seconds_until_closed(data, per_s) is None


def test_bursts_are_refused_and_close_nothing():
    """What waited while a link stood still comes all at once."""
    clock = Clock()
    at = validator(clock=clock)
    for _ in range(5):
        assert not any(floods(at, SMALL) for _ in range(10_000))
        clock.now += 5.0


def test_answers_have_a_limit():
    """Who sends rubbish is told ten times a second, and no more."""
    clock = Clock()
    at = validator(clock=clock)

    def answers() -> int:
        answered = 0
        for _ in range(100):
            with pytest.raises(MessageRefusedError) as refusal:
                at.check(b"rubbish")
            answered += refusal.value.answer is not None
        return answered

    assert answers() == ANSWERS_PER_S
    clock.now += 1.0
    assert answers() == ANSWERS_PER_S


def test_our_own_operations_go_no_further():
    """A beat's moment and a stop are for the relay."""
    clock_sync = check({"op": "robotether.beat", "t_ms": 81, "x": 1}, validator())
    assert (clock_sync.data, clock_sync.operation, clock_sync.drive) == (
        b"",
        "robotether.beat",
        None,
    )
    assert clock_sync.own == {"op": "robotether.beat", "t_ms": 81.0}
    keyed = check({"op": "robotether.beat", "t_ms": 81, "key": "k"}, validator())
    assert keyed.own == {"op": "robotether.beat", "t_ms": 81.0, "key": "k"}
    for key in (1, ["k"], "k" * 1025, "\ud800"):
        assert refused({"op": "robotether.beat", "key": key}, validator())[0] in {"shape", "json"}
    for t_ms in ("81", True, 1e300, [1]):
        assert refused({"op": "robotether.beat", "t_ms": t_ms}, validator())[0] == "shape"
    assert refused({"op": "robotether.control"}, validator("manage"))[0] == "operation"


def test_a_drive_command_is_recognised():
    """A publish to a drive topic comes with its moment and its speeds."""
    message = {
        "op": "publish",
        "topic": "left/cmd_vel",
        "msg": {"linear": {"x": 3, "y": 4}, "angular": {"z": -0.5}},
        "robotether": {"t_ms": 12.5, "fence": 99},
    }
    checked = check(message, validator("drive"))
    command = checked.drive
    assert command is not None
    assert (command.topic, command.stamp_ms) == ("/left/cmd_vel", 12.5)
    assert (command.speed_m_s, command.turn_rad_s) == (5.0, 0.5)
    assert "robotether" not in json.loads(checked.data)
    assert json.loads(stamped(command, 81.25, 13)) == {
        **message,
        "topic": "/left/cmd_vel",
        "robotether": {"t_ms": 81.25, "fence": 13},
    }


def test_other_publishes_are_no_commands():
    """Their moment is left out: only the guard knows it."""
    checked = check(
        {"op": "publish", "topic": "/a", "msg": {"x": 1}, "robotether": {"t_ms": 1, "fence": 1}},
        validator("manage"),
    )
    assert checked.drive is None
    assert json.loads(checked.data) == {"op": "publish", "topic": "/a", "msg": {"x": 1}}


@pytest.mark.parametrize(
    ("msg", "reason"),
    [({"data": "x"}, "is neither a Twist"), ({"linear": {"x": "1"}}, "no finite number")],
)
def test_a_drive_topic_takes_commands_only(msg, reason):
    """Whatever the level, what is no command does not get near the wheels."""
    for level in ("drive", "manage"):
        kind, answer = refused({"op": "publish", "topic": "/cmd_vel", "msg": msg}, validator(level))
        assert kind == "shape"
        assert reason in str(answer["msg"])


@pytest.mark.parametrize("stamp", [{}, {"t_ms": None}, {"t_ms": "1"}, 7, {"t_ms": 1e30}])
def test_a_timestamp_is_a_number(stamp):
    """A moment that cannot be read is no moment; the command goes nowhere."""
    message = {"op": "publish", "topic": "/cmd_vel", "msg": {}, "robotether": stamp}
    assert refused(message, validator("drive"))[0] == "shape"


@pytest.mark.parametrize(
    "data", [b"", b"{", b"[]", b"1", b"\xff\xfe", b"[" * 5000, b"{" + b"\xff" * 70_000 + b"}"]
)
def test_rubbish_passes_nobody(data):
    """What is no JSON object is answered, and says so."""
    for level in ("observe", "manage"):
        kind, answer = refused(data, validator(level))
        assert kind == "json"
        assert str(answer["msg"]).startswith("cannot read message: not JSON")


@pytest.mark.parametrize(
    ("data", "passed"),
    [
        (
            b'{"op": "publish", "op": "subscribe", "topic": "/a"}',
            {"op": "subscribe", "topic": "/a"},
        ),
        (
            b'{"op": "subscribe", "topic": "/b", "\\u0074opic": "/a"}',
            {"op": "subscribe", "topic": "/a"},
        ),
        (
            b'{"op": "publish", "topic": "/a", "msg": {"x": 1, "x": 2}}',
            {"op": "publish", "topic": "/a", "msg": {"x": 2}},
        ),
    ],
)
def test_of_a_key_twice_the_last_is_checked_and_sent(data, passed):
    """The robot gets it once; what comes first is neither checked nor sent."""
    assert sent(data, validator("manage")) == passed
    hidden = data.replace(b"/a", b"/cmd_vel").replace(b"subscribe", b"publish")
    assert refused(hidden, validator("observe"))[0] == "topic"


def test_a_status_carries_only_ids_that_rosbridge_knows():
    """A text or number as id comes back; anything else does not."""
    assert json.loads(status_error("x", "a"))["id"] == "a"
    assert json.loads(status_error("x", 7))["id"] == 7
    for no_id in ({"big": "thing"}, None, "x" * 2000, math.nan):
        assert "id" not in json.loads(status_error("x", no_id))


def test_names_are_looked_up_once():
    """Many globs cost nothing for a topic that is published again and again."""
    many = Globs([f"/x{number}*y" for number in range(64)])
    policy, looks = DEFAULTS.policy.drive, []

    class Counting(Globs):
        def match(self, name: str) -> bool:
            looks.append(name)
            return many.match(name)

    at = MessageValidator(policy, Counting(["/a"]), Limits())
    for _ in range(3):
        check({"op": "publish", "topic": "/x1y", "msg": {}}, at)
    assert looks == ["/x1y"]


def test_each_id_of_a_topic_counts_once():
    """The same subscription again changes nothing, also when there is room for no more."""
    mine = Subscriptions(2)
    assert [mine.add("/a", 1), mine.add("/a", 1), mine.add("/a", None)] == [True, True, True]
    assert [mine.add("/b", 1), mine.add("/a", 2), mine.add("/a", 1)] == [False, False, True]
    assert len(mine) == 2


def test_one_is_given_up_by_its_id():
    """Only that one makes room."""
    mine = Subscriptions(2)
    mine.add("/a", 1)
    mine.add("/a", 2)
    mine.remove("/a", 1)
    assert len(mine) == 1
    assert mine.add("/b", 1)
    assert not mine.add("/a", 1)


def test_without_an_id_all_of_the_topic_go():
    """As rosbridge does it."""
    mine = Subscriptions(3)
    for subscription in (("/a", 1), ("/a", None), ("/b", 1)):
        mine.add(*subscription)
    mine.remove("/a", None)
    assert len(mine) == 1


def test_giving_up_what_there_is_not_changes_nothing():
    """Neither the count nor what is kept."""
    mine = Subscriptions(1)
    mine.remove("/a", None)
    mine.remove("/a", 1)
    mine.add("/a", 1)
    mine.remove("/a", 2)
    mine.remove("/b", 1)
    assert len(mine) == 1


def strict_loads(text: str, deepest: int = 64) -> object:
    """Parse as the strictest robot may: few levels, 64 bits, no NaN, no half characters."""

    def number(digits: str) -> int:
        if not -(2**63) <= int(digits) < 2**64:
            raise ValueError(digits)
        return int(digits)

    def constant(name: str) -> float:
        raise ValueError(name)

    value = json.loads(text, parse_int=number, parse_constant=constant)
    if "inf" in re.sub(r"'[^']*'", "", repr(value)) or depth_of(value) > deepest:
        raise ValueError("nested too deep, or too large")
    json.dumps(value, ensure_ascii=False).encode()
    return value


def depth_of(value: object) -> int:
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    own = 1 if isinstance(value, dict | list) else 0
    return own + max((depth_of(item) for item in inner), default=0)


def run_by_rosbridge(text: str, deepest: int = 64) -> list[object]:
    """The operations that rosbridge may run of a text: it, or any object inside when it fails."""
    try:
        return [strict_loads(text, deepest)]
    except (ValueError, RecursionError):
        return list(_inner_operations(text, deepest))


def _inner_operations(text: str, deepest: int) -> Iterator[object]:
    ends = [place + 1 for place, letter in enumerate(text) if letter == "}"]
    for start in (place for place, letter in enumerate(text) if letter == "{"):
        for end in ends:
            try:
                inner = strict_loads(text[start:end], deepest)
            except ValueError:
                continue
            if isinstance(inner, dict) and "op" in inner:
                yield inner


HIDDEN = '{"op": "publish", "topic": "/cmd_vel", "msg": {}}'
UNCLEAR = ["1" * 30, "NaN", "1e999", "[" * 70 + "]" * 70, '"\\ud800"', "-Infinity", "-" + "9" * 19]
HIDING = [
    '{"op": "subscribe", "topic": "/a", "x": UNCLEAR, "y": HIDDEN}',
    '{"op": "subscribe", "topic": "/a", "qos": {"depth": UNCLEAR}, "y": HIDDEN}',
    '{"op": "subscribe", "topic": "/a", "id": UNCLEAR, "qos": HIDDEN}',
    '{"op": "call_service", "service": "/rosapi/nodes", "args": {"a": UNCLEAR, "b": HIDDEN}}',
    '{"op": "call_service", "service": "/rosapi/nodes", "args": [UNCLEAR, HIDDEN]}',
    '{"op": "call_service", "service": "/rosapi/nodes", "id": UNCLEAR, "args": HIDDEN}',
]


def validator_with(level: Level, **globs: Globs) -> MessageValidator:
    rights = LevelPolicy(**{"subscribe": Globs(["*"]), **globs}, drives=level != "observe")
    return MessageValidator(rights, DRIVE_TOPICS, Limits())


@pytest.mark.parametrize("unclear", UNCLEAR)
@pytest.mark.parametrize("message", HIDING)
def test_no_operation_hides_in_what_a_robot_cannot_parse(message, unclear):
    """What this parser reads and the robot's refuses makes rosbridge run nothing but the checked."""
    text = message.replace("UNCLEAR", unclear).replace("HIDDEN", HIDDEN)
    assert {"op": "publish", "topic": "/cmd_vel", "msg": {}} in run_by_rosbridge(text)
    try:
        passed = validator_with("observe").check(text.encode()).data.decode()
    except MessageRefusedError:
        return
    assert [operation["op"] for operation in run_by_rosbridge(passed, 2)] == [
        json.loads(text)["op"]
    ]


@pytest.mark.parametrize("unclear", UNCLEAR)
def test_no_command_hides_in_what_a_driver_publishes(unclear):
    """A message whose inside a robot could not parse does not go on at all."""
    text = '{"op": "publish", "topic": "/a", "msg": {"a": UNCLEAR, "b": HIDDEN}}'
    text = text.replace("UNCLEAR", unclear).replace("HIDDEN", HIDDEN)
    with pytest.raises(MessageRefusedError):
        validator_with("manage", publish=Globs(["*"])).check(text.encode())


NAME_LETTERS = "ab/_*~ .#"
NAMES = st.sampled_from(
    ["/cmd_vel", "cmd_vel", "/a/cmd_vel", "/rosapi/topics", "/rosapi/set_param"]
)
ANY_NAME = NAMES | NAMES | st.text("ab/_", max_size=8) | st.text(NAME_LETTERS, max_size=8)
GLOBS = st.lists(st.just("*") | st.text("ab/_*", min_size=1, max_size=6), max_size=3)
RIGHTS = st.fixed_dictionaries(dict.fromkeys(("subscribe", "publish", "call", "serve"), GLOBS))
JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.just("{"),
    lambda inner: (
        st.lists(inner) | st.dictionaries(st.sampled_from(["op", "topic", "id"]) | st.text(), inner)
    ),
    max_leaves=8,
)
FIELDS = sorted({name for entry in OPERATIONS.values() for name in entry.fields})
TWISTS = st.fixed_dictionaries(
    {}, optional={part: st.dictionaries(st.sampled_from("xyz"), st.floats()) for part in ("linear", "angular")}
)  # fmt: skip


@st.composite
def messages(draw: st.DrawFn) -> dict[str, object]:
    """A message with names that nearly or really match, and fields of any kind."""
    fields = st.sampled_from(FIELDS) | st.text()
    # Most with nothing but what is needed, since a wrong field hides all else that is wrong.
    message = draw(st.dictionaries(fields, JSON_VALUES, max_size=draw(st.sampled_from([0, 0, 3]))))
    operation = draw(st.sampled_from(sorted(OPERATIONS)))
    named = OPERATIONS[operation].named_by or "topic"
    message.setdefault(named, draw(ANY_NAME))
    if operation == "publish":
        message["msg"] = draw(TWISTS | JSON_VALUES)
    return {**message, "op": operation}


@st.composite
def spelled(draw: st.DrawFn, message: object) -> bytes:
    """The message as JSON, in one of the ways in which the same can be written."""
    text = json.dumps(
        message, ensure_ascii=draw(st.booleans()), indent=draw(st.sampled_from([None, 1]))
    )
    if draw(st.booleans()):
        # Inside of texts every character may be an escape.
        text = re.sub(r"(?<![\\\w])[a-z/](?=[a-z_/]*\")", lambda hit: f"\\u{ord(hit[0]):04x}", text)
    return text.encode(errors="surrogatepass")


def as_textbook(globs: list[str], name: str) -> bool:
    return any(re.fullmatch(".*".join(map(re.escape, glob.split("*"))), name) for glob in globs)


@settings(max_examples=4 * settings.default.max_examples)
@given(st.data(), st.sampled_from(["observe", "drive"]), messages(), RIGHTS)
def test_what_passes_is_what_the_policy_allows(data, level, message, rights):
    """In whatever spelling: a full name that the level's globs match, and only fields of the list."""
    at = validator_with(level, **{right: Globs(globs) for right, globs in rights.items()})
    try:
        checked = at.check(data.draw(spelled(message)))
    except MessageRefusedError:
        return
    entry = OPERATIONS[checked.operation]
    if entry.own:
        assert checked.data == b""
        return
    (run,) = run_by_rosbridge(checked.data.decode())
    assert run["op"] == checked.operation == message["op"]
    assert run.keys() <= {"op", *entry.fields} - {"robotether"}
    if entry.named_by is not None:
        name = run[entry.named_by]
        assert re.fullmatch(r"(/[A-Za-z0-9_]+)+", name)
        assert name.lstrip("/") == message[entry.named_by].lstrip("/")
        is_drive_topic = as_textbook(list(DRIVE_TOPICS), name)
        assert (
            as_textbook(rights[entry.right], name)
            or (entry.right == "publish" and level == "drive" and is_drive_topic)
            or (checked.operation == "call_service" and name in ROSAPI_LOOKUPS_OF_DRIVERS)
        )
        assert (checked.drive is not None) == (checked.operation == "publish" and is_drive_topic)


@settings(max_examples=2 * settings.default.max_examples)
@given(messages())
def test_what_is_written_passes_again_as_it_is(message):
    """It is read as the same operation with the same fields."""
    everything = {right: Globs(["*"]) for right in ("subscribe", "publish", "call", "serve")}
    at = validator_with("manage", **everything)
    try:
        checked = at.check(json.dumps(message).encode())
    except MessageRefusedError:
        return
    if checked.own is None:
        assert at.check(checked.data) == checked._replace(
            drive=checked.drive and checked.drive._replace(stamp_ms=None)
        )


@given(
    st.sampled_from(["subscribe", "unsubscribe", "call_service", "status", "set_level"]),
    messages(),
    st.sampled_from(["/rosapi/topics", "/rosapi/set_param", "/reset"]),
)
def test_whatever_an_observer_sends_context_one_thing(operation, others, service):
    """What passes is one flat message that the strictest parser reads, of the checked operation."""
    message = {"topic": "/a", **others, "service": service, "op": operation}
    try:
        passed = validator_with("observe").check(json.dumps(message).encode()).data.decode()
    except MessageRefusedError:
        return
    (run,) = run_by_rosbridge(passed, 2)
    assert run == json.loads(passed)
    assert run["op"] == operation
    assert run.get("service", "/rosapi/topics") == "/rosapi/topics"
