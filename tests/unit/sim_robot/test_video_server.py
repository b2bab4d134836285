"""The camera under web_video_server's URLs, read as a viewer does."""

import asyncio
import time
from collections.abc import AsyncIterator
from dataclasses import replace

import aiohttp
import pytest
from sim_client import SETTINGS, WAIT_S, until
from sim_robot.simulator import Simulator
from yarl import URL

TOPIC = "/camera/image_raw"


@pytest.fixture
async def http(simulator: Simulator) -> AsyncIterator[aiohttp.ClientSession]:
    """An HTTP client of the robot's video server."""
    base = f"http://127.0.0.1:{simulator.video.port}"
    timeout = aiohttp.ClientTimeout(total=20)
    async with aiohttp.ClientSession(base, timeout=timeout) as session:
        yield session


async def read_part(content: aiohttp.StreamReader) -> tuple[dict[str, str], bytes]:
    """Read one part of a stream after its boundary: headers and body."""
    headers = {}
    while line := (await asyncio.wait_for(content.readline(), WAIT_S)).decode().strip():
        name, _, value = line.partition(": ")
        headers[name] = value
    body = await content.readexactly(int(headers["Content-Length"]))
    assert await content.readline() == b"\r\n"
    assert await content.readline() == b"--boundarydonotcross\r\n"
    return headers, body


async def test_viewers_share_frames_and_leave_nothing_running(
    simulator: Simulator, http: aiohttp.ClientSession
) -> None:
    """Three viewers cost as many drawings as one, and none when they are gone."""
    url = f"/stream?topic={TOPIC}&width=64&height=48"
    async with http.get(url) as first, http.get(url) as second, http.get(url) as third:
        for answer in (first, second, third):
            await answer.content.readline()
        before, start = simulator.feeds[TOPIC].drawn, time.monotonic()
        for _ in range(10):
            for answer in (first, second, third):
                await read_part(answer.content)
        # A busy machine may draw a second's frames at once.
        assert simulator.feeds[TOPIC].drawn - before <= (time.monotonic() - start) * 15 + 15
    await until("viewers gone", lambda: not simulator.video._runner.server.connections)
    drawn = simulator.feeds[TOPIC].drawn
    await asyncio.sleep(0.2)  # three frames' time in which nothing may happen
    assert simulator.feeds[TOPIC].drawn == drawn


async def test_stream_of_no_topic_ends_without_a_frame(http: aiohttp.ClientSession) -> None:
    """As from the real one: headers, a boundary, the end."""
    async with http.get("/stream?topic=/nope") as answer:
        assert answer.status == 200
        assert await answer.read() == b"--boundarydonotcross\r\n"


REAR = "/rear/image_raw"


@pytest.mark.parametrize("qos", ["", "&qos_profile=default"])
async def test_best_effort_camera_is_not_heard_reliably(
    http: aiohttp.ClientSession, qos: str
) -> None:
    """As with the real one in ROS 2: the stream is open and silent; with the sensors' QoS there are frames."""
    async with http.get(f"/stream?topic={REAR}{qos}") as silent:
        assert await silent.content.readline() == b"--boundarydonotcross\r\n"
        async with http.get(f"/stream?topic={REAR}&qos_profile=sensor_data") as heard:
            assert await heard.content.readline() == b"--boundarydonotcross\r\n"
            for _ in range(3):
                await read_part(heard.content)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(silent.content.readline(), 0.1)


async def test_qos_is_nothing_to_ros_1() -> None:
    """It has no such word."""
    async with Simulator(replace(SETTINGS, ros_version=1)) as simulator:
        url = f"http://127.0.0.1:{simulator.video.port}/snapshot?topic={REAR}"
        async with aiohttp.ClientSession() as http, http.get(url) as answer:
            assert answer.content_type == "image/jpeg"


@pytest.mark.parametrize("topic", ["%2Fcamera%2Fimage_raw", "/camera/image%5Fraw"])
async def test_escapes_in_a_topic_are_not_undone(http: aiohttp.ClientSession, topic: str) -> None:
    """As in the real one, whose async_web_server_cpp takes the query's words as they stand."""
    with pytest.raises(aiohttp.ClientError):
        await http.get(URL(f"/snapshot?topic={topic}", encoded=True))


@pytest.mark.parametrize(
    "query",
    [
        "width=0",
        "height=-1",
        "width=2049",
        "quality=101",
        "quality=x",
        "width=1e3",
        "height=99999999999",
    ],
)
async def test_wrong_number_is_400_and_named(http: aiohttp.ClientSession, query: str) -> None:
    """A size or quality out of range is refused by name."""
    name, _, value = query.partition("=")
    for path in ("/stream", "/snapshot"):
        async with http.get(f"{path}?topic={TOPIC}&{query}") as answer:
            assert answer.status == 400
            text = await answer.text()
            assert name in text
            assert value in text
