"""The frames protocol over real sockets, and what the agent answers in web_video_server's place."""

from __future__ import annotations

from collections.abc import AsyncIterator

import aiohttp
import pytest
from fake_cameras import FakeVideoServer
from fake_cloud import eventually
from frames_viewer import FramesViewer
from local_network import free_port
from noted_pacer import NotedPacer
from robotether_agent.clock import robot_time
from robotether_agent.rosbridge import RosGraph
from robotether_agent.video import frames_service as service_module
from robotether_agent.video import receiver as receiver_module
from robotether_agent.video.frames_service import FramesService
from robotether_agent.video.sources import SourceSettings
from robotether_agent.video.video_proxy import LocalService, VideoProxy
from timed_websocket import timed_session

TOPIC = "/camera/image_raw"


class World:
    """A service in front of a camera, and those who receive from it."""

    def __init__(self, camera: FakeVideoServer, http: aiohttp.ClientSession) -> None:
        self.camera = camera
        self.http = http
        self.viewers: list[FramesViewer] = []
        self.has_video = True
        rosbridge_url = f"ws://127.0.0.1:{free_port()}"
        self.service = FramesService(
            SourceSettings(
                camera.url,
                rosbridge_url,
                "web_video_server",
                {"front": f"{camera.url}/stream?topic=/front"},
            ),
            RosGraph(rosbridge_url),
            has_video=lambda: self.has_video,
        )

    async def start(self) -> None:
        self.url = f"http://127.0.0.1:{await self.service.start()}"

    async def connect(self, topic: str = TOPIC) -> FramesViewer:
        url = f"{self.url}/robotether/frames?topic={topic}"
        self.viewers.append(FramesViewer(await self.http.ws_connect(url, max_msg_size=0)))
        return self.viewers[-1]

    async def receive(self, topic: str = TOPIC, **wanted: object) -> FramesViewer:
        """Connect, and wait for a frame."""
        viewer = await self.connect(topic)
        await viewer.ask(**wanted)
        await viewer.credit()
        await viewer.frame()
        return viewer

    async def get(self, path: str) -> tuple[int, bytes]:
        async with self.http.get(self.url + path) as answer:
            return answer.status, await answer.read()


@pytest.fixture
async def world() -> AsyncIterator[World]:
    async with FakeVideoServer() as camera, timed_session() as http:
        made = World(camera, http)
        await made.start()
        yield made
        for viewer in made.viewers:
            await viewer.socket.close()
        await made.service.close()


async def test_a_receiver_that_takes_nothing_costs_nothing(world, monkeypatch):
    monkeypatch.setattr(receiver_module, "IDLE_S", 0.3)
    viewer = await world.connect()
    await viewer.ask()
    await eventually(lambda: world.camera.open == 1, lambda: "the camera is open")
    await eventually(lambda: world.camera.open == 0, lambda: f"{world.camera.open} are open")
    asked_s = robot_time()
    await viewer.credit()
    assert (await viewer.frame()).timestamp_ms / 1000 > asked_s


async def test_no_receiver_no_source(world):
    """One without a `stream_request` opens nothing, and the last one to leave closes the source."""
    silent = await world.connect()
    await silent.socket.send_json({"op": "clock_sync", "t_ms": 1})
    await silent.text("clock_sync")
    assert world.camera.asked == []
    first, second = [await world.receive(), await world.receive()]
    assert (len(world.camera.asked), world.camera.open_most) == (1, 1)
    await first.socket.close()
    await second.credit()
    await second.frame()
    await second.socket.close()
    await eventually(lambda: world.camera.open == 0, lambda: f"{world.camera.open} are open")


async def test_a_camera_of_the_settings_is_opened_once(world):
    """Whatever is requested: a device can be read by one process alone."""
    await world.receive("front")
    await world.receive("front", codecs=["h264", "jpeg"], fps=5, width=320, height=240)
    assert (len(world.camera.asked), world.camera.open_most) == (1, 1)


async def test_all_others_overtake_a_receiver_that_yields(world):
    port, pacer = int(world.url.rpartition(":")[2]), NotedPacer()
    local = LocalService(port, yields=world.service.yields)
    proxy = VideoProxy(world.camera.url, local, pacer=pacer)
    world.url = f"http://127.0.0.1:{await proxy.start()}"
    viewer = await world.receive(yields=True)
    assert pacer.turns[-1][1]
    await viewer.ask()
    await viewer.credit()
    await viewer.frame()
    assert not pacer.turns[-1][1]
    await proxy.close()


async def test_cameras_and_receivers_are_bounded(world, monkeypatch):
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
    await first.socket.close()
    await eventually(lambda: world.service._topics.total() == 2, lambda: "the place is free")
    await world.receive("/b")


async def test_a_still_of_a_camera_that_is_down_tells_why(world, monkeypatch):
    monkeypatch.setattr(service_module, "STILL_WITHIN_S", 0.05)
    world.camera.mode = "refuses"
    viewer = await world.connect()
    await viewer.ask()
    while "HTTP status 500" not in (await viewer.text("status"))["detail"]:
        pass
    status, body = await world.get(f"/snapshot?topic={TOPIC}")
    assert (status, b"HTTP status 500" in body) == (503, True)
    assert (await world.get(f"/stream?topic={TOPIC}"))[0] == 503
    assert (await world.get("/robotether/snapshot?topic=" + "x" * 300))[0] == 400


async def test_whoever_looks_whether_video_works_is_told(world):
    """The answer is a list; without any video it is as if nothing listened, which is what the server asks."""
    assert (await world.get("/"))[0] == 200
    world.has_video = False
    with pytest.raises(aiohttp.ClientError):
        await world.get("/")
