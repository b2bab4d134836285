"""The proxy in front of web_video_server, and what the agent answers in its place."""

import asyncio
import socket
import time
from contextlib import asynccontextmanager

import aiohttp
import pytest
from fake_cameras import FakeVideoServer
from fake_cloud import eventually
from frames_viewer import FramesViewer
from local_network import free_port
from robotether_agent.clock import robot_time
from robotether_agent.rosbridge import RosGraph
from robotether_agent.video import frames_service as service_module
from robotether_agent.video import receiver as receiver_module
from robotether_agent.video import video_proxy as proxy_module
from robotether_agent.video.bandwidth_estimator import Reading
from robotether_agent.video.frames_service import FramesService
from robotether_agent.video.pacer import Pacer
from robotether_agent.video.sources import SourceSettings
from robotether_agent.video.video_proxy import BULK_AFTER_BYTES, LocalService, VideoProxy
from tcp_service import TcpService
from timed_websocket import timed_session


class NotedPacer(Pacer):
    """`turns` has the size of each turn that was requested, and whether as bulk."""

    def __init__(self):
        super().__init__()
        self.turns = []

    async def acquire(self, requested, *, is_bulk=False):
        self.turns.append((requested, is_bulk))
        return await super().acquire(requested, is_bulk=is_bulk)


WITHIN_S = 5


class Camera(TcpService):
    def __init__(self):
        super().__init__()
        self.handler = self._echo
        self.open = 0

    async def _talk(self, reader, writer):
        self.open += 1
        try:
            await self.handler(reader, writer)
        finally:
            self.open -= 1

    async def _echo(self, reader, writer):
        while data := await reader.read(65536):
            writer.write(data)
            await writer.drain()


@pytest.fixture
async def camera():
    async with Camera() as made:
        yield made
        await eventually(lambda: made.open == 0, lambda: f"{made.open} streams are open")


@pytest.fixture
async def proxy(camera):
    made = VideoProxy(f"http://localhost:{camera.port}", LocalService(1), Pacer())
    yield made
    await made.close()


class LocalMedia(TcpService):
    async def _talk(self, reader, writer):
        writer.write(b"own:" + await reader.readuntil(b"\r\n\r\n"))
        await writer.drain()


@asynccontextmanager
async def beside(port, when="never"):
    async with LocalMedia() as local:
        proxy = VideoProxy(f"http://127.0.0.1:{port}", LocalService(local.port, when), Pacer())
        yield await proxy.start()
        await proxy.close()


class LargeTopic(TcpService):
    async def _talk(self, reader, writer):
        await reader.readuntil(b"\r\n\r\n")
        writer.write(bytes(100_000))
        await writer.drain()


async def test_a_large_message_of_a_topic_is_bulk_from_its_beginning():
    """Else many large topics, each of which gets little through a full line, take it from the video."""
    pacer = NotedPacer()
    async with LargeTopic() as local:
        proxy = VideoProxy("http://127.0.0.1:1", LocalService(local.port), pacer)
        request = b"GET /robotether/topics HTTP/1.1\r\nHost: x\r\n\r\n"
        assert len(await asked(await proxy.start(), request)) == 100_000
        await proxy.close()
    assert sum(size for size, is_bulk in pacer.turns if not is_bulk) <= BULK_AFTER_BYTES


async def asked(port, *pieces):
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    for piece in pieces:
        writer.write(piece)
        await writer.drain()
        # A segment of its own each: the video proxy is to see halves.
        await asyncio.sleep(0.02)
    try:
        writer.write_eof()
        return await asyncio.wait_for(reader.read(-1), WITHIN_S)
    except ConnectionError:
        # Ended without an answer, and before all was read.
        return b""
    finally:
        writer.close()


OWN_REQUEST = b"GET /robotether/frames?topic=/camera HTTP/1.1\r\nHost: x\r\n\r\n"


@pytest.mark.parametrize("pieces", [1, len(OWN_REQUEST)])
async def test_the_agents_own_urls_lead_to_the_agent(camera, pieces):
    length = len(OWN_REQUEST) // pieces
    parts = [OWN_REQUEST[at : at + length] for at in range(0, len(OWN_REQUEST), length)]
    async with beside(camera.port) as port:
        assert await asked(port, *parts) == b"own:" + OWN_REQUEST


@pytest.mark.parametrize(
    "request_bytes",
    [
        b"GET /stream?topic=/camera HTTP/1.1\r\n\r\n",
        b"GET /robotethe",
        b"GET /robotetherX/ HTTP/1.1\r\n\r\n",
        b"POST /robotether/frames HTTP/1.1\r\n\r\n",
        b"",
    ],
)
async def test_all_else_passes_unchanged(camera, request_bytes):
    async with beside(camera.port, "down") as port:
        assert await asked(port, request_bytes[:7], request_bytes[7:]) == request_bytes


async def test_a_request_that_stops_halfway_is_not_held_for_long(camera, monkeypatch):
    monkeypatch.setattr(proxy_module, "FIRST_WORDS_S", 0.2)
    async with beside(camera.port) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET /robo")
        assert await asyncio.wait_for(reader.readexactly(9), WITHIN_S) == b"GET /robo"
        writer.write(b"tether/frames")
        assert await asyncio.wait_for(reader.readexactly(13), WITHIN_S) == b"tether/frames"
        writer.close()


@pytest.mark.parametrize(
    ("when", "runs", "answers"),
    [
        ("never", True, b""),
        ("never", False, None),
        ("down", True, b""),
        ("down", False, b"own:"),
        ("always", True, b"own:"),
    ],
)
async def test_who_answers_in_web_video_servers_place(camera, when, runs, answers):
    """As the settings say: nobody, the agent while nothing answers there, or always the agent."""
    request = b"GET /stream?topic=/camera HTTP/1.1\r\n\r\n"
    expected = b"" if answers is None else answers + request
    async with beside(camera.port if runs else free_port(), when) as port:
        assert await asked(port, request) == expected


async def test_a_viewer_that_leaves_ends_the_stream(proxy, camera):
    async def stream(_, writer):
        while True:
            writer.write(bytes(10_000))
            await writer.drain()

    camera.handler = stream
    reader, writer = await asyncio.open_connection("127.0.0.1", await proxy.start())
    writer.write(b"x")
    await reader.readexactly(50_000)
    writer.transport.abort()
    await eventually(lambda: camera.open == 0, lambda: "the stream has ended")


async def test_a_viewer_of_nothing_is_let_go(proxy, camera, monkeypatch):
    """One who asks no more and gets nothing any more; a camera without frames would never notice."""
    monkeypatch.setattr(proxy_module, "LAST_S", 0.1)
    forever = asyncio.Event()

    async def silent(*_):
        await forever.wait()

    camera.handler = silent
    reader, writer = await asyncio.open_connection("127.0.0.1", await proxy.start())
    writer.write_eof()
    assert await asyncio.wait_for(reader.read(-1), WITHIN_S) == b""
    writer.close()
    forever.set()


async def test_streams_have_a_number(proxy, camera, monkeypatch):
    monkeypatch.setattr(proxy_module, "MAX_STREAMS", 1)
    port = await proxy.start()
    first = await asyncio.open_connection("127.0.0.1", port)
    first[1].write(b"x")
    assert await first[0].readexactly(1) == b"x"
    second = await asyncio.open_connection("127.0.0.1", port)
    assert await asyncio.wait_for(second[0].read(-1), WITHIN_S) == b""
    first[1].write(b"y")
    assert await first[0].readexactly(1) == b"y"
    for _, writer in (first, second):
        writer.close()


async def test_the_camera_waits_while_the_window_is_full(camera):
    written = 0

    async def stream(_, writer):
        nonlocal written
        writer.transport.set_write_buffer_limits(high=0)
        while True:
            writer.write(bytes(10_000))
            written += 10_000
            await writer.drain()

    camera.handler = stream
    # 14,480 bytes may go; nothing ever arrives.
    started = time.monotonic()

    def stalled(_, now_s):
        handed = 14_480 if now_s > started else 0
        return Reading(now_s, handed, 0, 0.04, 0.04, 1448)

    proxy = VideoProxy(f"http://127.0.0.1:{camera.port}", LocalService(1), Pacer(stalled))
    with socket.socket() as handle:
        proxy.use(handle)
        _, writer = await asyncio.open_connection("127.0.0.1", await proxy.start())
        writer.write(b"x")
        await eventually(lambda: written > 0, lambda: "the camera sends")
        last = -1
        while written != last:
            last = written
            await asyncio.sleep(0.1)
        assert 0 < written < 300_000
        writer.close()
        await proxy.close()


TOPIC = "/camera/image_raw"


class World:
    """A service in front of a camera, and those who receive from it."""

    def __init__(self, camera, http):
        self.camera = camera
        self.http = http
        self.viewers = []
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

    async def start(self):
        self.url = f"http://127.0.0.1:{await self.service.start()}"

    async def connect(self, topic=TOPIC):
        url = f"{self.url}/robotether/frames?topic={topic}"
        self.viewers.append(FramesViewer(await self.http.ws_connect(url, max_msg_size=0)))
        return self.viewers[-1]

    async def receive(self, topic=TOPIC, **wanted):
        """Connect, and wait for a frame."""
        viewer = await self.connect(topic)
        await viewer.ask(**wanted)
        await viewer.credit()
        await viewer.frame()
        return viewer

    async def get(self, path):
        async with self.http.get(self.url + path) as answer:
            return answer.status, await answer.read()


@pytest.fixture
async def world():
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
    proxy = VideoProxy(world.camera.url, local, pacer)
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


@pytest.mark.parametrize(
    ("width", "height", "asked"), [(320, 320, ("320", "240")), (2000, 200, ("266", "200"))]
)
async def test_a_still_keeps_the_cameras_shape_in_the_requested_size(world, width, height, asked):
    """Those of the fleet page have one size for cameras of all shapes."""
    query = f"topic={TOPIC}&width={width}&height={height}"
    assert (await world.get(f"/robotether/snapshot?{query}"))[0] == 200
    whole, sized = world.camera.asked
    assert "width" not in whole
    assert (sized["width"], sized["height"]) == asked
    await world.get(f"/robotether/snapshot?{query}")
    assert len(world.camera.asked) == 3


async def test_whoever_looks_whether_video_works_is_told(world):
    """The answer is a list; without any video it is as if nothing listened, which is what the server asks."""
    assert (await world.get("/"))[0] == 200
    world.has_video = False
    with pytest.raises(aiohttp.ClientError):
        await world.get("/")
