"""The agent's own connection to rosbridge."""

from __future__ import annotations

import asyncio

import aiohttp
import pytest
from fake_cameras import TopicRosbridge
from fake_cloud import eventually
from fake_rosbridge import FakeRosbridge
from local_network import free_port
from robotether_agent import rosbridge as rosbridge_module
from robotether_agent.rosbridge import LOOK_UP_ID, connected, is_answer, same_type, topics_in
from stopwatch import Stopwatch

BYTES_MAX = 100_000


async def test_topics_with_types_as_ros_1_spells_them():
    kinds = {"/battery": "sensor_msgs/msg/BatteryState", "/scan": "sensor_msgs/LaserScan"}
    async with (
        TopicRosbridge(kinds) as robot,
        connected(robot.url, max_message_bytes=BYTES_MAX) as rosbridge,
    ):
        assert await rosbridge.topics() == {
            "/battery": "sensor_msgs/BatteryState",
            "/scan": "sensor_msgs/LaserScan",
        }
    assert same_type("a/msg/B") == same_type("a/B") == "a/B"


async def test_a_robot_without_rosapi_answers_nothing(monkeypatch):
    monkeypatch.setattr(rosbridge_module, "ANSWER_WITHIN_S", 0.1)
    async with (
        TopicRosbridge(None) as robot,
        connected(robot.url, max_message_bytes=BYTES_MAX) as rosbridge,
    ):
        with pytest.raises(asyncio.TimeoutError):
            await rosbridge.topics()


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


async def test_a_rosbridge_that_hangs_holds_nobody_up():
    """Whoever is cancelled is gone at once: the guard's stop may wait for it."""
    async with FakeRosbridge("slow_reader") as robot:

        async def hold() -> None:
            url = f"ws://127.0.0.1:{robot.port}"
            async with connected(url, max_message_bytes=BYTES_MAX) as rosbridge:
                await rosbridge.topics()

        holding = asyncio.ensure_future(hold())
        await eventually(lambda: len(robot.got) == 1, lambda: str(robot.got))
        with Stopwatch() as stopwatch:
            holding.cancel()
            await asyncio.gather(holding, return_exceptions=True)
        assert stopwatch.s < 0.05


async def test_no_rosbridge_is_an_error():
    with pytest.raises(aiohttp.ClientConnectorError):
        async with connected(f"ws://127.0.0.1:{free_port()}", max_message_bytes=BYTES_MAX):
            pass


def test_broken_answers_have_no_topics():
    assert is_answer({"op": "service_response", "id": LOOK_UP_ID})
    assert not is_answer({"op": "service_response", "id": "another's"})
    for values in (None, {}, {"topics": 5, "types": []}):
        assert topics_in({"values": values}) == {}
    mixed = {"topics": ["/a", 5, "/c"], "types": ["a/A", "b/B", None]}
    assert topics_in({"values": mixed}) == {"/a": "a/A"}
