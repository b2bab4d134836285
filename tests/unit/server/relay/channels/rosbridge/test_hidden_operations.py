"""No operation passes inside of another, in whatever spelling, also where the robot reads less than the relay."""

import json
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robotether_common.ros import Globs
from robotether_server.relay.channels.rosbridge.message_validator import (
    MessageRefusedError,
    MessageValidator,
)
from robotether_server.relay.channels.rosbridge.operations import (
    OPERATIONS,
    ROSAPI_LOOKUPS_OF_DRIVERS,
)
from robotether_server.settings.robot import LevelPolicy, Limits

DRIVE_TOPICS = Globs(["/cmd_vel", "*/cmd_vel"])


def strict_loads(text, deepest=64):
    """Parse as the strictest robot may: few levels, 64 bits, no NaN, no half characters."""

    def number(digits):
        if not -(2**63) <= int(digits) < 2**64:
            raise ValueError(digits)
        return int(digits)

    def constant(name):
        raise ValueError(name)

    value = json.loads(text, parse_int=number, parse_constant=constant)
    if "inf" in re.sub(r"'[^']*'", "", repr(value)) or depth_of(value) > deepest:
        raise ValueError("nested too deep, or too large")
    json.dumps(value, ensure_ascii=False).encode()
    return value


def depth_of(value):
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    own = 1 if isinstance(value, dict | list) else 0
    return own + max((depth_of(item) for item in inner), default=0)


def run_by_rosbridge(text, deepest=64):
    """The operations that rosbridge may run of a text: it, or any object inside when it fails."""
    try:
        return [strict_loads(text, deepest)]
    except (ValueError, RecursionError):
        return list(_inner_operations(text, deepest))


def _inner_operations(text, deepest):
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


def validator_with(level, **globs):
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
def messages(draw):
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
def spelled(draw, message):
    """The message as JSON, in one of the ways in which the same can be written."""
    text = json.dumps(
        message, ensure_ascii=draw(st.booleans()), indent=draw(st.sampled_from([None, 1]))
    )
    if draw(st.booleans()):
        # Inside of texts every character may be an escape.
        text = re.sub(r"(?<![\\\w])[a-z/](?=[a-z_/]*\")", lambda hit: f"\\u{ord(hit[0]):04x}", text)
    return text.encode(errors="surrogatepass")


def as_textbook(globs, name):
    return any(re.fullmatch(".*".join(map(re.escape, glob.split("*"))), name) for glob in globs)


@settings(max_examples=2 * settings.default.max_examples)
@given(st.data(), st.sampled_from(["observe", "drive"]), messages(), RIGHTS)
def test_what_passes_is_what_the_policy_allows(data, level, message, rights):
    at = validator_with(level, **{right: Globs(globs) for right, globs in rights.items()})
    try:
        checked = at.check(data.draw(spelled(message)))
    except MessageRefusedError:
        return
    entry = OPERATIONS[checked.operation]
    if entry.own:
        assert checked.data == b""
        return
    # Of what an observer sends without a right to publish, call or serve, the strictest parser reads one message, at
    # most with the durations of a QoS profile.
    may_nest = level == "drive" or entry.right in {"publish", "call", "serve"}
    (run,) = run_by_rosbridge(checked.data.decode(), 64 if may_nest else 3)
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
