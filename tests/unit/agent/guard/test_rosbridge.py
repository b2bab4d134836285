"""The guard's connections before rosbridges of all moods."""

import asyncio
import time
from contextlib import asynccontextmanager
from unittest.mock import Mock

import pytest
from aiohttp import WSMsgType
from fake_rosbridge import FakeRosbridge
from robotether_agent.guard.rosbridge import CmdVelPublisher, SubscriberWatch
from robotether_agent.rosbridge_socket import (
    CONNECT_WITHIN_S,
    SEND_BUFFER_BYTES,
    new_http,
    open_rosbridge,
)
from sim_client import until


async def test_a_rosbridge_that_does_not_read_is_seen_and_left_soon():
    """What waits is counted, and a goodbye that it does not take is cut short."""
    async with FakeRosbridge(mode="slow_reader") as rosbridge, new_http() as http:
        socket = await open_rosbridge(http, f"ws://127.0.0.1:{rosbridge.port}/")
        await socket.send_frame(b"{}", WSMsgType.TEXT)
        frame = b"{}" + b" " * SEND_BUFFER_BYTES
        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(_send_on(socket, frame), 2)
        assert 0 < socket.waiting_bytes() < 8 * SEND_BUFFER_BYTES
        await asyncio.wait_for(socket.leave(), 10)
        socket.drop()
        socket.drop()


async def _send_on(socket, frame):
    while True:
        await socket.send_frame(frame, WSMsgType.TEXT)


@asynccontextmanager
async def running(rosbridge):
    """A line that is connected, and who listens to it."""
    heard = Mock()
    async with new_http() as http:
        line = CmdVelPublisher(http, time.monotonic)
        task = asyncio.create_task(line.run(heard))
        line.use(f"ws://127.0.0.1:{rosbridge.port}/")
        await until("it is up", lambda: heard.on_rosbridge_connected.called)
        yield line, heard
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_what_is_sent_is_known_to_be_read():
    async with FakeRosbridge() as rosbridge, running(rosbridge) as (line, heard):
        assert line.up
        assert line.can_send
        message = b'{"op":"publish","topic":"/echo"}'
        assert await line.send(message)
        sent_at = time.monotonic()
        await until("it is read", lambda: heard.on_rosbridge_drained.called)
        assert 0 < line.read_until <= sent_at
        await until("it is answered", lambda: heard.on_rosbridge_message.called)
        heard.on_rosbridge_message.assert_called_once_with(message)


async def test_a_rosbridge_that_does_not_read_is_full_and_then_stalled(monkeypatch):
    """Long before TCP would tell; and it is used again when it reads."""
    monkeypatch.setattr("robotether_agent.guard.rosbridge.IDLE_PING_EVERY_S", 0.05)
    async with FakeRosbridge(mode="slow_reader") as rosbridge, running(rosbridge) as (line, _):
        await line.send(b'{"op":"x"}')
        await until("it is full", lambda: not line.can_send)
        assert line.up
        await until("it is stalled", lambda: line.stalled and not line.up)
        rosbridge.read_on()
        await until("it reads", lambda: line.can_send and line.up)


async def test_it_connects_again_for_ever(monkeypatch):
    failures = []
    monkeypatch.setattr(
        "robotether_agent.guard.rosbridge.describe_error", lambda *why: failures.append(why)
    )
    async with FakeRosbridge() as rosbridge, running(rosbridge) as (line, heard):
        await rosbridge.stop()
        await until("it is lost", lambda: heard.on_rosbridge_lost.called)
        assert not line.up
        assert not line.can_send
        assert not await line.send(b"{}")
        await until("it has failed", lambda: len(failures) > 1)
        assert failures[0][1] == CONNECT_WITHIN_S, "the time that is waited for an answer"
        await rosbridge.start()
        await until("it is up again", lambda: heard.on_rosbridge_connected.call_count == 2)


async def test_a_rosbridge_that_closes_at_once_is_logged_once(caplog):
    async with FakeRosbridge(mode="closes") as rosbridge, running(rosbridge) as (_, heard):
        await until("it tries again", lambda: heard.on_rosbridge_lost.call_count > 2)
        assert caplog.text.count("it closed the connection") == 1
        rosbridge.mode = "good"
        await until("it answers", lambda: "answers the publisher" in caplog.text)


async def test_the_watch_is_not_sure_on_ros_2(monkeypatch, spawn):
    """Whatever type the driver's client advertises."""
    monkeypatch.setattr("robotether_agent.guard.rosbridge.WATCH_EVERY_S", 0.01)
    driver = Mock(**{"driven_now.return_value": ["/cmd_vel"]})
    async with FakeRosbridge({"/cmd_vel": "geometry_msgs/msg/Twist"}) as rosbridge:
        watch = spawn(SubscriberWatch(driver, lambda: rosbridge.url).run())
        rosbridge.subscribers = []
        for rosbridge.publishers in (["/rosbridge"], []):
            driver.on_unheard.reset_mock()
            await until("it has looked", lambda: driver.on_unheard.call_count > 2)
            driver.on_unheard.assert_called_with(frozenset({"/cmd_vel"}), is_sure=False)
        watch.cancel()
        driver.on_unregistered.assert_not_called()


async def test_the_watch_says_what_nothing_listens_to(monkeypatch, spawn):
    """A rosapi that has never said, or hides the topic, is no reason for a word; one that says no more is."""
    monkeypatch.setattr("robotether_agent.guard.rosbridge.WATCH_EVERY_S", 0.01)
    driver = Mock(**{"driven_now.return_value": ["/cmd_vel"]})
    async with FakeRosbridge({}) as rosbridge:
        watch = spawn(SubscriberWatch(driver, lambda: rosbridge.url).run())

        def unheard():
            return driver.on_unheard.call_args.args[0]

        async def answers(publishers, subscribers):
            rosbridge.publishers, rosbridge.subscribers = publishers, subscribers
            count = driver.on_unheard.call_count
            # The answer after the next one was asked for with these lists.
            await until("two answers", lambda: driver.on_unheard.call_count >= count + 2)
            return bool(unheard())

        assert not await answers(None, None)
        assert unheard() == frozenset()
        assert not await answers([], [])
        assert not await answers(["/rosbridge"], ["/base"])
        assert await answers(["/rosbridge"], [])
        driver.on_unregistered.assert_not_called()
        # A new master knows the base, which began with it, and not rosbridge.
        assert await answers([], ["/base"])
        driver.on_unregistered.assert_called_with("/cmd_vel")
        assert not await answers(["/rosbridge"], ["/base"])
        assert unheard() == frozenset()
        # An observer listens by rosbridge, or a base does.
        assert not await answers(["/rosbridge"], ["/rosbridge"])
        assert unheard() is None
        assert not await answers(["/rosbridge"], ["/rosbridge", "/base"])
        assert unheard() == frozenset()
        # As of a rosapi that the new master does not know: what was an answer is one no more.
        unclear = [(None, None), (["/rosbridge"], None), ("?", ["/base"])]
        for publishers, subscribers in unclear:
            assert not await answers(publishers, subscribers)
            assert unheard() is None
        asked = [m["args"] for m in rosbridge.got]
        assert asked == [{"topic": "/cmd_vel"}] * len(asked)
        watch.cancel()
