"""What a client may send of operations that pass: how often, how large, and how many subscriptions."""

import pytest
from robotether_server.relay.channels.rosbridge.message_validator import (
    MessageRefusedError,
    ValidatedMessage,
)
from validators import Clock, check, refused, sent, validator


def test_subscriptions_are_counted():
    at = validator("observe", {"policy": {"limits": {"subscriptions": 2}}})
    sent({"op": "subscribe", "topic": "/a", "id": "1"}, at)
    sent({"op": "subscribe", "topic": "/a", "id": "1"}, at)
    sent({"op": "subscribe", "topic": "/a", "id": "2"}, at)
    kind, answer = refused({"op": "subscribe", "topic": "/b", "id": "3"}, at)
    assert kind == "subscriptions"
    assert "has 2 subscriptions" in str(answer["msg"])
    # One is given up by its id, and without one all of the name, as rosbridge does.
    for given_up in ({"topic": "/a", "id": "3"}, {"topic": "/b", "id": "1"}, {"topic": "a"}):
        sent({"op": "unsubscribe", **given_up}, at)
    assert refused({"op": "subscribe", "topic": "/b"}, at)[0] == "subscriptions"
    sent({"op": "unsubscribe", "topic": "/a", "id": "1"}, at)
    sent({"op": "subscribe", "topic": "/a"}, at)
    assert refused({"op": "subscribe", "topic": "/b"}, at)[0] == "subscriptions"
    sent({"op": "unsubscribe", "topic": "/a"}, at)
    for number in (1, 2):
        sent({"op": "subscribe", "topic": "/b", "id": number}, at)


@pytest.mark.parametrize(("level", "per_s"), [("drive", 50), ("observe", 5)])
def test_the_rate_has_a_limit(level, per_s):
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
    limits = {"messages_per_s": 50, "message_kb": 100}
    at = validator("manage", {"policy": {"limits": limits}})
    large = {"op": "publish", "topic": "/a", "msg": {"data": "x" * 102_000}}
    sent(large, at)
    assert refused(large, at)[0] == "rate"
    kind, answer = refused({**large, "msg": {"data": "x" * 102_400}}, at)
    assert (kind, "over 100 KB" in str(answer["msg"])) == ("size", True)


def test_a_stop_alone_passes_at_any_rate():
    """What only names it, in an id or a text, is held to the rate as all else is; a bad press keeps none back."""
    at = validator("observe", {"policy": {"limits": {"messages_per_s": 1, "message_kb": 1}}})
    for _ in range(2):
        sent({"op": "subscribe", "topic": "/a"}, at)
    for message in (
        {"op": "subscribe", "topic": "/a", "id": "robotether.stop"},
        {"op": "status", "msg": "robotether.stop"},
    ):
        assert refused(message, at)[0] == "rate"
    stop = {"op": "robotether.stop"}
    assert check(stop, at) == ValidatedMessage(b"", "robotether.stop", own=stop)
    for press in (7, {}, "x" * 65):
        own = stop | {"press": None}
        assert check(stop | {"press": press}, at) == ValidatedMessage(
            b"", "robotether.stop", own=own
        )


SMALL, LARGE = b'{"op":"subscribe","topic":"/a"}', b" " * 100_000
STOP = b'{"op":"robotether.stop"}'


def floods(at, data):
    try:
        at.check(data)
    except MessageRefusedError as refusal:
        return refusal.floods
    return False


def seconds_until_closed(data, per_s, *, within_s=10):
    """Send so many messages a second through an observer's validator of 200 a second; None: it is never closed."""
    clock = Clock()
    at = validator(clock=clock, settings={"policy": {"limits": {"message_kb": 1}}})
    for count in range(per_s * within_s):
        clock.now = 1000.0 + count / per_s
        if floods(at, data):
            return clock.now - 1000.0
    return None


@pytest.mark.parametrize(("data", "per_s"), [(SMALL, 1000), (SMALL, 5_000), (LARGE, 50)])
def test_who_goes_on_sending_too_much_is_closed(data, per_s):
    """Each refusal costs the relay time, so it does not go on refusing for ever."""
    closed_after_s = seconds_until_closed(data, per_s)
    assert closed_after_s is not None
    assert 3 <= closed_after_s <= 6


@pytest.mark.parametrize(("data", "per_s"), [(SMALL, 190), (SMALL, 300), (STOP, 2000), (LARGE, 1)])
def test_who_sends_a_little_too_much_or_stops_is_not(data, per_s):
    assert seconds_until_closed(data, per_s) is None
