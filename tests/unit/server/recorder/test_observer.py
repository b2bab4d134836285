"""What of a robot's topics is recorded."""

import asyncio
import json
import math
import struct

import pytest
from aiohttp import WSMessage, WSMsgType
from robotether_server.contract.ros import POLICY_REFUSES
from robotether_server.recorder import observer
from robotether_server.recorder.observer import RosbridgeObserver

SPEED = {
    "type": "demo/Speed",
    "fieldnames": ["value"],
    "fieldtypes": ["float32"],
    "fieldarraylen": [-1],
}


class RosbridgeSocket:
    """A robot with these topics, each of which has these messages, as texts in place of JSON."""

    def __init__(self, topics, *messages):
        self._topics, self._messages = topics, messages
        self.throttles = {}
        # Why the relay refuses topics, by their names.
        self.refused, self.was_refused = {}, set()
        # Services that do not answer.
        self.silent = set()
        self._texts = asyncio.Queue()

    async def send_str(self, text):
        message = json.loads(text)
        if message["op"] == "subscribe":
            topic = message["topic"]
            if (why := self.refused.get(topic)) is not None:
                status = {"op": "status", "level": "error", "id": message["id"], "msg": why}
                await self._put(json.dumps(status))
                self.was_refused.add(topic)
                return
            self.throttles[topic] = message["throttle_rate"]
            await self.publish(topic)
            return
        if message["op"] == "unsubscribe":
            self.throttles.pop(message["topic"], None)
            return
        if message["service"] in self.silent:
            return
        values = {
            "topics": list(self._topics),
            "types": list(self._topics.values()),
            "typedefs": [SPEED],
        }
        answer = {"op": "service_response", "id": message["id"], "values": values, "result": True}
        await self._put(json.dumps(answer))

    async def publish(self, topic):
        for content in self._messages:
            await self._put(f'{{"op": "publish", "topic": "{topic}", "msg": {content}}}')

    async def _put(self, text):
        await self._texts.put(WSMessage(WSMsgType.TEXT, text, None))

    def __aiter__(self):
        return self

    async def __anext__(self):
        return await self._texts.get()


def observing_robot(socket, write, on_cameras=list, *, drive_topic="", on_left_out=list):
    return RosbridgeObserver(
        "sim1",
        socket,
        write,
        on_cameras,
        drive_topic=lambda: drive_topic,
        on_left_out=on_left_out,
    )


async def recorded(socket, count, *, on_cameras=list, drive_topic=""):
    """Return the messages that are recorded, until there are so many."""
    messages = asyncio.Queue()
    observer = observing_robot(socket, messages.put_nowait, on_cameras, drive_topic=drive_topic)
    observing = asyncio.create_task(observer.run())
    try:
        async with asyncio.timeout(5):
            return [await messages.get() for _ in range(count)]
    finally:
        observing.cancel()
        await asyncio.gather(observing, return_exceptions=True)


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "null"])
async def test_a_number_that_json_lacks_leaves_the_rest_of_its_message(number):
    socket = RosbridgeSocket({"/speed": "demo/Speed"}, f'{{"value": {number}, "name": "NaN"}}')
    [message] = await recorded(socket, 1)
    [value] = struct.unpack_from("<f", message.data, 4)
    assert math.isnan(value)


async def test_a_topic_that_comes_back_with_another_type_is_recorded_with_that(monkeypatch):
    monkeypatch.setattr(observer, "DISCOVER_EVERY_S", 0)
    topics, channels = {"/speed": "demo/Unknown"}, asyncio.Queue()

    def write(message):
        channels.put_nowait(message.channel.type)
        topics["/speed"] = "demo/Speed"

    socket = RosbridgeSocket(topics, '{"value": 0.5}')
    observing = asyncio.create_task(observing_robot(socket, write).run())
    async with asyncio.timeout(5):
        assert await channels.get() != "demo/msg/Speed"
        assert await channels.get() == "demo/msg/Speed"
    observing.cancel()
    await asyncio.gather(observing, return_exceptions=True)


async def test_a_type_that_rosapi_describes_late_is_no_text_any_longer(monkeypatch):
    monkeypatch.setattr(observer, "DISCOVER_EVERY_S", 0.01)
    monkeypatch.setattr(observer, "ANSWER_WITHIN_S", 0.01)
    socket, channels = RosbridgeSocket({"/speed": "demo/Speed"}, '{"value": 0.5}'), asyncio.Queue()
    socket.silent.add("/rosapi/message_details")
    observing = asyncio.create_task(observing_robot(socket, channels.put_nowait).run())
    async with asyncio.timeout(5):
        assert (await channels.get()).channel.type == "std_msgs/msg/String"
        socket.silent.clear()
        is_typed = False
        while not is_typed:
            await socket.publish("/speed")
            is_typed = (await channels.get()).channel.type == "demo/msg/Speed"
    observing.cancel()
    await asyncio.gather(observing, return_exceptions=True)


async def test_of_a_graph_with_many_robots_one_is_recorded():
    """The other robots would take all places if only type and name decided."""
    topics = {}
    for number in range(9):
        topics |= {
            f"/robot{number}/cmd_vel": "geometry_msgs/msg/Twist",
            f"/robot{number}/odom": "nav_msgs/msg/Odometry",
            f"/robot{number}/image_raw": "sensor_msgs/msg/Image",
            f"/robot{number}/tf_static": "tf2_msgs/msg/TFMessage",
        }
    cameras = []
    socket = RosbridgeSocket(topics, "{}")
    messages = await recorded(socket, 3, on_cameras=cameras.extend, drive_topic="/robot8/cmd_vel")
    names = [message.channel.topic for message in messages]
    assert names == ["/robot8/odom", "/robot8/tf_static", "/robot8/cmd_vel"]
    # Each publisher's transforms come once.
    assert socket.throttles == {"/robot8/odom": 100, "/robot8/tf_static": 0, "/robot8/cmd_vel": 100}
    assert cameras == ["/robot8/image_raw"]


async def test_what_comes_first_takes_a_place_and_what_has_none_is_named(monkeypatch):
    """Odometry may come minutes after sixteen others, and these stay in their places but for it."""
    monkeypatch.setattr(observer, "DISCOVER_EVERY_S", 0)
    names, rounds = [f"/{number:02}" for number in range(17)], asyncio.Queue()
    forbidden = f"cannot subscribe to /pose: {POLICY_REFUSES}; an admin changes it"
    topics = dict.fromkeys(names[1:], "demo/Speed") | {"/image": "sensor_msgs/msg/Image"}
    socket = RosbridgeSocket(topics, "{}")
    observing = asyncio.create_task(
        observing_robot(socket, [].append, on_left_out=rounds.put_nowait).run()
    )

    async def until_left_out(*topics):
        while await rounds.get() != [*topics]:
            pass

    async with asyncio.timeout(5):
        await until_left_out()
        topics[names[0]] = "demo/Speed"
        await until_left_out(names[0])
        topics["/odom"] = "nav_msgs/msg/Odometry"
        await until_left_out(names[16], names[0])
        del topics["/odom"]
        topics["/pose"] = "turtlesim/Pose"
        socket.refused = {"/pose": forbidden, names[0]: "it sends 48 topics already"}
        while socket.was_refused != {"/pose", names[0]}:
            await rounds.get()
        await until_left_out("/pose", names[0], names[16])
        socket.refused.clear()
        await until_left_out("/pose", names[16])
    observing.cancel()
    await asyncio.gather(observing, return_exceptions=True)
    assert socket.throttles.keys() == {*names[:16]}


@pytest.mark.parametrize("broken", ['{"value": "fast"}', "{]"])
async def test_a_message_that_cannot_be_recorded_leaves_those_after_it(broken):
    socket = RosbridgeSocket({"/speed": "demo/Speed"}, broken, '{"value": 0.5}')
    [message] = await recorded(socket, 1)
    assert struct.unpack_from("<f", message.data, 4) == (0.5,)
