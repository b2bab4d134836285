"""The whole robot: its loop keeps its rate while somebody looks."""

import asyncio
import dataclasses

import aiohttp
import pytest
from sim_client import SETTINGS, SocketClient
from sim_robot.simulator import Simulator


async def test_camera_does_not_disturb_the_loop(simulator: Simulator) -> None:
    """With two viewers of different sizes, 125 steps take 2 s and none is skipped."""
    loop = asyncio.get_running_loop()
    base = f"http://127.0.0.1:{simulator.video.listener.port}/stream?topic=/camera/image_raw"
    async with (
        aiohttp.ClientSession() as http,
        http.get(base) as large,
        http.get(base + "&width=320&height=240&quality=50") as small,
        SocketClient(simulator.rosbridge.listener.port) as client,
    ):
        readers = [asyncio.create_task(_read_on(answer)) for answer in (large, small)]
        await client.send(op="subscribe", topic="/odom")
        await client.receive()
        start, steps = loop.time(), simulator.robot.steps
        for _ in range(125):
            await client.receive()
        took = loop.time() - start
        assert simulator.robot.steps - steps == pytest.approx(took * 62.5, abs=3)
        assert simulator.rate.skipped == 0
        assert simulator.feed.drawn > 20
        for task in readers:
            task.cancel()
        await asyncio.gather(*readers, return_exceptions=True)


async def _read_on(answer: aiohttp.ClientResponse) -> None:
    async for _ in answer.content.iter_any():
        pass


async def test_reset_service_over_rosbridge(simulator: Simulator) -> None:
    """/reset is offered to clients."""
    async with SocketClient(simulator.rosbridge.listener.port) as client:
        answer = await client.ask(op="call_service", service="/reset", id="r")
        assert (answer["result"], answer["values"]) == (True, {})


async def test_camera_is_listed(simulator: Simulator) -> None:
    """A client that looks for cameras finds one."""
    async with SocketClient(simulator.rosbridge.listener.port) as client:
        answer = await client.ask(
            op="call_service",
            service="/rosapi/topics_for_type",
            args={"type": "sensor_msgs/Image"},
        )
        assert answer["values"] == {"topics": ["/camera/image_raw"]}


async def test_taken_port_leaves_nothing_open(simulator: Simulator) -> None:
    """When the video port is taken, rosbridge's is free again."""
    settings = dataclasses.replace(SETTINGS, video_port=simulator.video.listener.port)
    other = Simulator(settings)
    with pytest.raises(OSError, match="address already in use"):
        async with other:
            pass
    with pytest.raises(OSError, match="Connect call failed"):
        await asyncio.open_connection("127.0.0.1", other.rosbridge.listener.port)
