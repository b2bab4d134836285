"""The agent's own connections to rosbridge, and the topics that it passes on."""

import asyncio
import json

import aiohttp
import pytest
from aiohttp import web
from fake_cloud import eventually
from fake_rosbridge import FakeRosbridge
from robotether_agent import rosbridge as rosbridge_module
from robotether_agent import rosbridge_socket
from robotether_agent.fields import FieldError
from robotether_agent.rosbridge import RosGraph, connected, topics_in
from robotether_agent.rosbridge_socket import close_reason
from robotether_agent.topics_service import TopicsService, parse_subscription
from robotether_common.topics import FRESH_BYTES, PATH, digest
from timed_websocket import timed_session

BYTES_MAX = 100_000


async def test_messages_of_a_subscription(caplog):
    async with (
        FakeRosbridge({}) as robot,
        connected(robot.url, max_message_bytes=BYTES_MAX) as rosbridge,
    ):
        await rosbridge.subscribe("/battery", "sensor_msgs/BatteryState", throttle_ms=5000)
        wish = await robot.subscription("/battery")
        assert (wish["throttle_rate"], wish["queue_length"]) == (5000, 1)
        (socket,) = robot.sockets
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
async def asking():
    async with FakeRosbridge({"/a": "a/msg/A"}) as robot:
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


ODOM = {"op": "subscribe", "topic": "/odom"}


class World:
    def __init__(self, rosbridge, http, port):
        self.rosbridge = rosbridge
        self._http = http
        self.url = f"http://127.0.0.1:{port}{PATH}"

    async def open(self, subscription=None, **query):
        subscription = ODOM if subscription is None else subscription
        before = len(self.rosbridge.got)
        relay = await self._http.ws_connect(self.url, params=query, max_msg_size=0)
        await relay.send_json(subscription)
        if subscription.get("op") == "subscribe":
            await eventually(lambda: len(self.rosbridge.got) > before, lambda: "it is subscribed")
        return relay


@pytest.fixture
async def world():
    async with FakeRosbridge({}) as rosbridge, timed_session() as http:
        service = TopicsService(rosbridge.url)
        app = web.Application()
        app.router.add_get(PATH, service.answer)
        runner = web.AppRunner(app, handler_cancellation=True, shutdown_timeout=0.2)
        await runner.setup()
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        yield World(rosbridge, http, runner.addresses[0][1])
        await runner.cleanup()
        await service.close()


async def test_messages_pass_as_rosbridge_sends_them(world):
    requested = {**ODOM, "qos": {"depth": 1, "lifespan": {"secs": 1, "nsecs": 0}}}
    relay = await world.open(requested)
    assert world.rosbridge.got == [requested]
    await world.rosbridge.publish("/odom", {"x": 1})
    message = await relay.receive_json(timeout=5)
    assert message == {"op": "publish", "topic": "/odom", "msg": {"x": 1}}
    await relay.close()
    await eventually(lambda: world.rosbridge.open == 0, lambda: "it is unsubscribed")


@pytest.mark.parametrize(
    "text",
    [
        '{"op": "publish", "topic": "/cmd_vel", "msg": {}}',
        '{"op": "call_service", "service": "/reset"}',
        '{"topic": "/odom"}',
        '{"op": "subscribe"}',
        '{"op": "subscribe", "topic": "/a b"}',
        '{"op": "subscribe", "topic": "/odom", "msg": {"op": "publish"}}',
        '{"op": "subscribe", "topic": "/odom", "type": {"op": "publish"}}',
        '{"op": "subscribe", "topic": "/odom", "qos": {"a": {"op": "publish"}}}',
        '{"op": "subscribe", "topic": "/odom", "qos": [{"op": "publish"}]}',
        '{"op": "subscribe", "topic": "/odom", "qos": {"a": {"b": {"c": 1}}}}',
        "[]",
        "{",
    ],
)
def test_nothing_but_a_subscription_may_pass(text):
    """This way leads past the guard."""
    with pytest.raises(FieldError):
        parse_subscription(text)


async def test_who_sends_anything_else_is_ended_and_rosbridge_gets_nothing(world):
    relay = await world.open({"op": "publish", "topic": "/cmd_vel", "msg": {}})
    assert (await relay.receive(timeout=5)).data == 1002
    second = await world.open()
    await second.send_str(json.dumps({"op": "publish", "topic": "/cmd_vel", "msg": {}}))
    assert (await second.receive(timeout=5)).data == 1002
    assert world.rosbridge.got == [ODOM]


async def test_a_relay_that_takes_little_gets_the_newest_and_then_its_pong(world):
    """So no message behind the pong is older than the ping, also where the newest waits for a slow line."""
    relay = await world.open()
    relay._autoping = False
    relay._response.connection.transport.pause_reading()
    for number in range(400):
        await world.rosbridge.publish("/odom", {"number": number, "large": "x" * FRESH_BYTES})
        await asyncio.sleep(0)
    await relay.ping(b"1")
    relay._response.connection.transport.resume_reading()
    numbers = []
    while (message := await relay.receive(timeout=5)).type is not aiohttp.WSMsgType.PONG:
        numbers.append(json.loads(message.data)["msg"]["number"])
    assert (numbers[-1], message.data) == (399, b"1")
    assert numbers == sorted(numbers)
    assert len(numbers) < 399
    await relay.close()


async def test_what_rosbridge_repeats_to_a_newcomer_is_named_up_to_the_first_that_is_new(world):
    texts = [
        json.dumps({"op": "publish", "topic": "/odom", "msg": {"x": number}}).encode()
        for number in (1, 2, 3)
    ]
    relay = await world.open(known=",".join(map(digest, texts[:2])))
    for number in (2, 1, 3, 1):
        await world.rosbridge.publish("/odom", {"x": number})
    for text in (texts[1], texts[0]):
        assert await relay.receive_json(timeout=5) == {
            "op": "robotether.known",
            "digest": digest(text),
        }
    assert (await relay.receive(timeout=5)).type is aiohttp.WSMsgType.CLOSE


async def test_a_message_over_the_limit_ends_its_topic_and_the_limit_is_said(world, monkeypatch):
    monkeypatch.setattr(rosbridge_socket, "FROM_ROBOT_BYTES", 1024 * 1024)
    relay = await world.open()
    publishing = asyncio.create_task(world.rosbridge.publish("/odom", {"x": "x" * 2 * 1024 * 1024}))
    message = await relay.receive(timeout=5)
    why = "a message has over 1 MB, the limit of the robot's agent"
    assert (message.data, message.extra) == (aiohttp.WSCloseCode.MESSAGE_TOO_BIG, why)
    await asyncio.gather(publishing, return_exceptions=True)


def test_a_close_reason_is_cut_between_characters():
    """A close frame with half of one is an error."""
    assert close_reason("x" + "é" * 80) == b"x" + "é".encode() * 61


async def test_without_rosbridge_the_answer_says_so(world):
    await world.rosbridge.stop()
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        await world.open()
    assert refused.value.status == 502
    why = refused.value.headers["Robotether-Reason"]
    assert why == "rosbridge does not answer: Connection refused"
    await world.rosbridge.start()
