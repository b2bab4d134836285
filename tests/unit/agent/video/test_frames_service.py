"""The frames protocol over real sockets, and what the agent answers in web_video_server's place."""

from __future__ import annotations

import asyncio
import json
import os
import time
from collections.abc import AsyncIterator
from typing import Any

import aiohttp
import pytest
from fake_cameras import FakeVideoServer, number_of
from fake_cloud import eventually
from frame_header import SIZE, unpacked
from local_network import free_port
from robotether_agent.clock import robot_time
from robotether_agent.rosbridge import RosGraph
from robotether_agent.video import frames_service as service_module
from robotether_agent.video import receiver as receiver_module
from robotether_agent.video.frame_messages import Header
from robotether_agent.video.frames_service import FramesService
from robotether_agent.video.sources import SourceSettings
from robotether_common.codecs import H264, JPEG
from timed_websocket import timed_session
from video_clips import Decoder, clip, jpeg_of

WITHIN_S = 5
TOPIC = "/camera/image_raw"


class FakeReceiver:
    """The relay's end: gives credit when a test says, or for each frame that comes."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse, *, gives_credit: bool) -> None:
        self._socket = socket
        self._gives_credit = gives_credit
        self.texts: list[dict[str, Any]] = []
        self.pictures: list[tuple[Header, bytes]] = []
        self.ages_s: list[float] = []
        self.closed: int | None = None
        self._task = asyncio.ensure_future(self._read())

    async def say(self, op: str, **fields: object) -> None:
        await self._socket.send_json({"op": op, **fields})

    async def leave(self) -> None:
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        await self._socket.close()

    def statuses(self) -> list[dict[str, Any]]:
        return [text for text in self.texts if text["op"] == "status"]

    def states(self) -> list[str]:
        return [status["state"] for status in self.statuses()]

    def told(self) -> str:
        return f"{len(self.pictures)} pictures, {self.texts[-3:]}, closed {self.closed}"

    async def some(self, count: int) -> None:
        await eventually(lambda: len(self.pictures) >= count, self.told)

    async def _read(self) -> None:
        async for message in self._socket:
            if message.type is aiohttp.WSMsgType.TEXT:
                self.texts.append(json.loads(message.data))
            elif message.type is aiohttp.WSMsgType.BINARY:
                header = unpacked(message.data)
                self.pictures.append((header, message.data[SIZE:]))
                self.ages_s.append(robot_time() - header.timestamp_ms / 1000)
                if self._gives_credit:
                    await self.say("credit", frames=1, taken=header.sequence)
        self.closed = self._socket.close_code


class World:
    """A service in front of a camera, and those who receive from it."""

    def __init__(self, camera: FakeVideoServer, http: aiohttp.ClientSession) -> None:
        self.camera = camera
        self.http = http
        self.source_settings = SourceSettings(
            camera.url, f"ws://127.0.0.1:{free_port()}", "web_video_server"
        )
        self.receivers: list[FakeReceiver] = []
        self.has_video = True

    async def start(
        self, source_settings: SourceSettings | None = None, video_encoder: str = "off"
    ) -> None:
        chosen = source_settings or self.source_settings
        self.graph = RosGraph(chosen.rosbridge_url)
        self.service = FramesService(
            chosen,
            self.graph,
            video_encoder=video_encoder,
            has_video=lambda: self.has_video,
        )
        self.port = await self.service.start()

    async def receive(
        self,
        topic: str = TOPIC,
        *,
        gives_credit: bool = True,
        port: int = 0,
        **stream_request: object,
    ) -> FakeReceiver:
        url = f"http://127.0.0.1:{port or self.port}/robotether/frames"
        socket = await self.http.ws_connect(url, params={"topic": topic}, max_msg_size=0)
        self.receivers.append(FakeReceiver(socket, gives_credit=gives_credit))
        await self.receivers[-1].say("stream_request", **stream_request)
        if gives_credit:
            await self.receivers[-1].say("credit", frames=2)
        return self.receivers[-1]

    async def get(self, path: str, **options: object) -> tuple[int, bytes]:
        url = f"http://127.0.0.1:{self.port}{path}"
        async with self.http.get(url, **options) as answer:
            return answer.status, await answer.read()


@pytest.fixture
async def world() -> AsyncIterator[World]:
    """A robot with web_video_server, and its service running."""
    async with FakeVideoServer() as camera, timed_session() as http:
        made = World(camera, http)
        await made.start()
        yield made
        for receiver in made.receivers:
            await receiver.leave()
        await made.service.close()


async def test_frames_come_with_their_timestamp_and_sequence(world):
    """The newest first, each newer than the last, at the wanted rate."""
    world.camera.stamp = lambda: time.time() - 0.1
    receiver = await world.receive(fps=15, quality_max=70)
    await receiver.some(30)
    headers = [header for header, _ in receiver.pictures]
    assert [unpacked(h.packed()) for h in headers] == headers
    numbers = [header.sequence for header in headers]
    assert numbers == sorted(set(numbers))
    # The camera has 30 a second, or fewer on a busy machine.
    lasted_s = (headers[-1].timestamp_ms - headers[0].timestamp_ms) / 1000
    assert len(headers) - 4 <= 15 * lasted_s
    assert {(header.quality, header.is_stamped) for header in headers} == {(70, True)}
    assert all(0.1 <= age_s < 1 for age_s in receiver.ages_s)
    shown = [number_of(jpeg) for _, jpeg in receiver.pictures]
    assert shown == sorted(set(shown))


async def test_a_receiver_that_decodes_h264_gets_it_once_the_encoder_runs(world, monkeypatch):
    """JPEGs come first, then each frame can be decoded after those before it, and none is older."""
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    world.camera.picture = jpeg_of(next(clip(1, step=0)))
    await world.service.close()
    await world.start(video_encoder="auto")
    receiver = await world.receive(codecs=["h264", "vp8", "jpeg"])

    def encoded() -> list[tuple[Header, bytes]]:
        return [frame for frame in receiver.pictures if frame[0].codec is H264]

    await eventually(lambda: len(encoded()) >= 30, receiver.told, 30)
    decoder = Decoder()
    for _, data in encoded():
        assert decoder.decode(data).shape == (240, 320, 3)
    assert receiver.pictures[0][0].codec is JPEG
    assert all(age_s < 1 for age_s in receiver.ages_s)


async def test_a_receiver_that_takes_nothing_costs_nothing(world, monkeypatch):
    """Its source is closed after a while, and open again with its next credit."""
    monkeypatch.setattr(receiver_module, "IDLE_S", 0.3)
    receiver = await world.receive(gives_credit=False)
    await eventually(lambda: world.camera.open == 1, lambda: "the camera is open")
    await eventually(lambda: world.camera.open == 0, lambda: f"{world.camera.open} are open")
    await receiver.say("credit")
    await receiver.some(1)
    assert receiver.ages_s[0] < 1


async def test_no_receiver_no_source(world):
    """One without a `stream_request` opens nothing, and the last one to leave closes the source."""
    url = f"http://127.0.0.1:{world.port}/robotether/frames"
    async with world.http.ws_connect(url, params={"topic": TOPIC}) as silent:
        await silent.send_json({"op": "clock_sync", "t_ms": 1})
        await silent.receive_json(timeout=WITHIN_S)
        assert world.camera.asked == []
    both = [await world.receive(), await world.receive()]
    for receiver in both:
        await receiver.some(3)
    assert (len(world.camera.asked), world.camera.open_most) == (1, 1)
    await both[0].leave()
    await both[1].some(len(both[1].pictures) + 3)
    await both[1].leave()
    await eventually(lambda: world.camera.open == 0, lambda: f"{world.camera.open} are open")


async def test_the_status_tells_of_a_source_that_ends_and_comes_back(world):
    """Live, down with the reason, live again by itself."""
    receiver = await world.receive()
    await eventually(lambda: "live" in receiver.states(), receiver.told)
    await world.camera.stop()
    await eventually(lambda: "down" in receiver.states(), receiver.told)
    down = next(status for status in receiver.statuses() if status["state"] == "down")
    assert "web_video_server at" in down["detail"]
    assert (down["source"], down["width"], down["height"]) == ("web_video_server", None, None)
    await world.camera.start()
    await eventually(lambda: receiver.states()[-1] == "live", receiver.told)
    assert receiver.closed is None


async def test_another_want_counts_from_now_on(world):
    receiver = await world.receive(quality_max=70)
    await receiver.some(3)
    await receiver.say("stream_request", quality_max=40, width=320, height=240)
    await eventually(lambda: receiver.pictures[-1][0].quality == 40, receiver.told)
    assert world.camera.asked[-1]["quality"] == "40"
    assert (world.camera.asked[-1]["width"], world.camera.asked[-1]["height"]) == ("320", "240")


async def test_cameras_and_receivers_are_bounded(world, monkeypatch):
    """503 beyond; a place that was left is free again."""
    monkeypatch.setattr(service_module, "MAX_SHARED_SOURCES", 2)
    monkeypatch.setattr(service_module, "MAX_RECEIVERS", 3)
    first = await world.receive("/a")
    await world.receive("/b")
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        await world.receive("/c")
    assert refused.value.status == 503
    await world.receive("/a")
    with pytest.raises(aiohttp.WSServerHandshakeError):
        await world.receive("/a")
    await first.leave()
    await eventually(lambda: world.service._topics.total() == 2, lambda: "the place is free")
    await world.receive("/b")


async def test_a_still_of_a_camera_that_is_down_tells_why(world, monkeypatch):
    monkeypatch.setattr(service_module, "STILL_WITHIN_S", 0.3)
    world.camera.mode = "refuses"
    status, body = await world.get(f"/snapshot?topic={TOPIC}")
    assert (status, b"HTTP status 500" in body) == (503, True)
    assert (await world.get(f"/stream?topic={TOPIC}"))[0] == 503
    assert (await world.get("/robotether/snapshot?topic=" + "x" * 300))[0] == 400


async def test_whoever_looks_whether_video_works_is_told(world):
    """A list; without any video as if nothing listened, which is what the server asks."""
    assert (await world.get("/"))[0] == 200
    world.has_video = False
    with pytest.raises(aiohttp.ClientError):
        await world.get("/")


async def test_a_close_that_is_cancelled_leaves_nothing() -> None:
    """The agent may end while a connection of which it was part ends."""
    service = FramesService(SourceSettings("", "", "rosbridge"), RosGraph(""))
    await service.start()
    closing = asyncio.ensure_future(service.close())
    await asyncio.sleep(0)
    closing.cancel()
    with pytest.raises(asyncio.CancelledError):
        await closing
    assert service._http.closed
