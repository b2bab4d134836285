"""The agent's own connection to rosbridge."""

from __future__ import annotations

import asyncio

import pytest
from fake_cameras import TopicRosbridge
from fake_cloud import eventually
from robotether_agent.rosbridge import LOOK_UP_ID, connected, is_answer, topics_in

BYTES_MAX = 100_000


async def test_messages_of_a_subscription():
    """The newest only, by rosbridge's own means; other words are skipped, and the end is an error."""
    async with (
        TopicRosbridge({}) as robot,
        connected(robot.url, max_message_bytes=BYTES_MAX) as rosbridge,
    ):
        await rosbridge.subscribe("/battery", "sensor_msgs/BatteryState", throttle_ms=5000)
        await eventually(lambda: bool(robot.subscribed("/battery")), lambda: str(robot.got))
        wish = robot.subscribed("/battery")[0]
        assert (wish["throttle_rate"], wish["queue_length"]) == (5000, 1)
        (socket,) = robot._sockets
        for text in ("no JSON", "[]", '{"op": "status"}', '{"op": "publish", "msg": 5}'):
            await socket.send_str(text)
        await robot.publish("/battery", {"percentage": 0.5})
        assert await asyncio.wait_for(rosbridge.message(), 5) == {"percentage": 0.5}
        await robot.stop()
        with pytest.raises(ConnectionError):
            await asyncio.wait_for(rosbridge.message(), 5)


async def test_too_large_a_message_ends_the_connection():
    async with (
        TopicRosbridge({}) as robot,
        connected(robot.url, max_message_bytes=BYTES_MAX) as rosbridge,
    ):
        await rosbridge.subscribe("/a", "std_msgs/String", throttle_ms=0)
        await robot.publish("/a", {"data": "x" * BYTES_MAX})
        with pytest.raises(ConnectionError):
            await asyncio.wait_for(rosbridge.message(), 5)


def test_broken_answers_have_no_topics():
    assert is_answer({"op": "service_response", "id": LOOK_UP_ID})
    assert not is_answer({"op": "service_response", "id": "another's"})
    for values in (None, {}, {"topics": 5, "types": []}):
        assert topics_in({"values": values}) == {}
    mixed = {"topics": ["/a", 5, "/c"], "types": ["a/A", "b/B", None]}
    assert topics_in({"values": mixed}) == {"/a": "a/A"}
