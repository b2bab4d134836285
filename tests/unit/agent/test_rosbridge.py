"""The agent's own connection to rosbridge."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import aiohttp
import pytest
from fake_cameras import TopicRosbridge
from fake_cloud import eventually
from robotether_agent import rosbridge as rosbridge_module
from robotether_agent.rosbridge import RosGraph, connected, topics_in

BYTES_MAX = 100_000


async def test_messages_of_a_subscription(caplog):
    async with (
        TopicRosbridge({}) as robot,
        connected(robot.url, max_message_bytes=BYTES_MAX) as rosbridge,
    ):
        await rosbridge.subscribe("/battery", "sensor_msgs/BatteryState", throttle_ms=5000)
        wish = await robot.subscription("/battery")
        assert (wish["throttle_rate"], wish["queue_length"]) == (5000, 1)
        (socket,) = robot._sockets
        for text in ("no JSON", "[]", '{"op": "status"}', '{"op": "publish", "msg": 5}'):
            await socket.send_str(text)
        await robot.publish("/battery", {"percentage": 0.5})
        assert await asyncio.wait_for(rosbridge.message(), 5) == {"percentage": 0.5}
        (warning,) = caplog.messages
        assert warning.startswith("cannot read a message of /battery: ")
        await robot.stop()
        with pytest.raises(ConnectionError):
            await asyncio.wait_for(rosbridge.message(), 5)


def test_of_a_broken_answer_the_topics_count_that_are_as_they_should_be():
    assert topics_in({"topics": [], "types": []}) == {}
    mixed = {"topics": ["/a", 5, "/c"], "types": ["a/A", "b/B", None]}
    assert topics_in(mixed) == {"/a": "a/A"}


@pytest.fixture
async def asking() -> AsyncIterator[tuple[TopicRosbridge, RosGraph]]:
    async with TopicRosbridge({"/a": "a/msg/A"}) as robot:
        graph = RosGraph(robot.url)
        yield robot, graph
        await graph.close()


async def test_all_questions_go_over_one_connection_also_after_a_restart(asking):
    robot, graph = asking
    for _ in range(2):
        answers = await asyncio.gather(graph.topics(), graph.topics(), graph.is_published("/a"))
        assert answers == [{"/a": "a/A"}, {"/a": "a/A"}, True]
        assert (await graph.topics(), robot.open) == ({"/a": "a/A"}, 1)
        await robot.stop()
        with pytest.raises((OSError, aiohttp.ClientError)):
            await graph.topics()
        await robot.start()


@pytest.mark.parametrize(
    "values",
    [
        "Service /rosapi/topics does not exist",
        {},
        {"topics": 5, "types": []},
        {"topics": ["/a"]},
        {"topics": ["/a"], "types": []},
    ],
)
async def test_topics_that_rosapi_does_not_name_are_unknown_and_not_none(
    asking, monkeypatch, values
):
    robot, graph = asking
    monkeypatch.setattr(robot, "_look_up", lambda _: values)
    with pytest.raises(ConnectionError, match="does not say which topics"):
        await graph.topics()


async def test_what_is_answered_twice_or_to_no_call_is_no_other_calls_answer(asking):
    robot, graph = asking
    robot.publishers, robot.subscribers = ["/rosbridge"], ["/base"]
    robot.answer_ids = lambda call_id: [{}, 7, call_id, call_id]
    assert await graph.topics() == {"/a": "a/A"}
    async with connected(robot.url, max_message_bytes=BYTES_MAX) as rosbridge:
        for kind in ("publishers", "subscribers", "publishers"):
            call = rosbridge.call(f"/rosapi/{kind}", {"topic": "/a"})
            assert list(await asyncio.wait_for(call, 5)) == [kind]


async def test_a_silent_rosapi_holds_up_the_first_question_alone(asking, monkeypatch):
    """Who asks again is answered at once, without another connection, until it may be asked anew."""
    monkeypatch.setattr(rosbridge_module, "ANSWER_WITHIN_S", 0.2)
    robot, graph = asking
    topics, robot.topics = robot.topics, None
    with pytest.raises(asyncio.TimeoutError):
        await graph.topics()
    monkeypatch.setattr(rosbridge_module, "ANSWER_WITHIN_S", 3600)
    with pytest.raises(asyncio.TimeoutError):
        await graph.topics()
    await eventually(lambda: robot.open == 1, lambda: f"{robot.open} are open")
    robot.topics = topics
    monkeypatch.setattr(rosbridge_module, "SILENT_S", 0)
    assert await graph.topics() == {"/a": "a/A"}
