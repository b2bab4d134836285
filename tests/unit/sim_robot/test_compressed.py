"""A camera's pictures come as a topic while somebody is subscribed."""

import base64
import time

from sim_client import SocketClient, until
from sim_robot.simulator import Simulator
from stamped_picture import read_stamp

TOPIC = "/camera/image_raw/compressed"


async def test_subscriber_gets_new_pictures(simulator: Simulator) -> None:
    """Pictures are JPEG in base64, and each shows the moment that its header tells."""
    stamps = []
    async with SocketClient(simulator.rosbridge.listener.port) as client:
        await client.send(op="subscribe", topic=TOPIC, type="sensor_msgs/msg/CompressedImage")
        for _ in range(5):
            message = (await client.receive())["msg"]
            assert message["format"] == "jpeg"
            stamp = message["header"]["stamp"]
            told = stamp["sec"] + stamp["nanosec"] / 1e9
            shown = read_stamp(base64.b64decode(message["data"]))
            assert 0 <= told - shown < 0.0002
            stamps.append(shown)
    assert stamps == sorted(set(stamps))
    assert abs(time.time() - stamps[-1]) < 2


async def test_nobody_subscribed_nothing_is_drawn(simulator: Simulator) -> None:
    """Nothing is drawn before the first subscriber and after the last."""
    feed = simulator.feeds["/camera/image_raw"]
    assert feed.drawn == 0
    async with SocketClient(simulator.rosbridge.listener.port) as client:
        await client.send(op="subscribe", topic=TOPIC)
        await client.receive()
        await client.send(op="unsubscribe", topic=TOPIC)
        await client.ready()
        camera = simulator._compressed[0]
        await until("the camera rests", lambda: camera._task is not None and camera._task.done())
        drawn, steps = feed.drawn, simulator.robot.steps
        await until("some steps", lambda: simulator.robot.steps > steps + 20)
        assert feed.drawn == drawn


async def test_frozen_camera_shows_nothing_new(simulator: Simulator) -> None:
    """While the cameras are frozen no picture comes; afterwards the newest does."""
    async with SocketClient(simulator.rosbridge.listener.port) as client:
        await client.send(op="subscribe", topic=TOPIC)
        await client.receive()
        await client.ask(op="call_service", service="/sim/freeze_camera", args={"data": True})
        # One may have been under way.
        await client.send(op="subscribe", topic="/pose")
        messages = [await client.receive() for _ in range(40)]
        assert [message["topic"] for message in messages[-30:]] == ["/pose"] * 30
        thawed_at = time.time()
        await client.ask(op="call_service", service="/sim/freeze_camera", args={"data": False})
        while (message := await client.receive())["topic"] != TOPIC:
            pass
        assert read_stamp(base64.b64decode(message["msg"]["data"])) >= thawed_at - 0.001
