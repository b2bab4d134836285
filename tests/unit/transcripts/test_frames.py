"""The frames protocol (docs/reference/media.md) between agent, relay and viewer."""

import asyncio
import hashlib
import json
import struct
from dataclasses import replace

import aiohttp
import pytest
from fake_cameras import FakeVideoServer
from local_network import free_port
from relay_clients import closing
from relay_server import until
from robotether_agent.rosbridge import RosGraph
from robotether_agent.video import receiver
from robotether_agent.video.frames_service import FramesService
from robotether_agent.video.sources import SourceSettings
from timed_websocket import timed_session
from transcripts import UPGRADE, Transcript, problem_line

WAIT_S = 60.0
HEADER = struct.Struct("!BBHId")
BROKEN = [
    "no json",
    '{"op":7}',
    '{"op":"stream_request","fps":"1"}',
    '{"op":"stream_request","quality_min":60,"quality_max":50}',
    '{"op":"stream_request","width":640}',
    '{"op":"stream_request","width":5000,"height":1}',
    '{"op":"credit","frames":-1}',
    '{"op":"clock_sync"}',
    "x" * 5000,
]


def header_of(message):
    names = ("codec", "flags", "quality", "sequence", "timestamp_ms")
    return dict(zip(names, HEADER.unpack_from(message), strict=True))


def digest(message):
    """A short sum of the frame behind the header."""
    return hashlib.sha256(message[HEADER.size :]).hexdigest()[:12]


def frames_url(world, topic="topic=/a%20b/c"):
    ticket = world.relay.ticket(world.sim1, "observe")
    return f"{world.relay.url}/robots/sim1/video/frames?{topic}&ticket={ticket}"


async def ending_of(socket):
    code, reason = await closing(socket)
    return f"{code} {reason}".rstrip()


async def test_relay_and_viewer(world, recorded):
    """What a viewer gets, and what the robot is asked for meanwhile."""
    transcript = Transcript(("sender_ms", "timestamp_ms"))
    camera = (await world.robot("guard_off")).frames
    async with world.http.ws_connect(frames_url(world), compress=15) as viewer:
        assert not viewer.compress, "frames are compressed as they are"

        async def add(what):
            message = await viewer.receive(timeout=WAIT_S)
            if message.type is aiohttp.WSMsgType.TEXT:
                transcript.add(f"relay, {what}:", json.loads(message.data))
            else:
                data = message.data
                transcript.add(f"relay, {what}:", data[:8].hex(" "), header_of(data))
                transcript.add("  frame:", {"size": len(data) - HEADER.size, "sum": digest(data)})

        await viewer.send_json({"op": "stream_request", "fps": 5, "quality_max": 60})
        await camera.wait_for("credit")
        transcript.add("robot is asked for the camera:", json.dumps(camera.topics[0]))
        await camera.send_status(state="waiting", source="mjpeg", quality=70, fps=0, x=1)
        await add("a status")
        await viewer.send_json({"op": "clock_sync", "t_ms": 81.25})
        await add("a clock sync")
        for number, (size, quality) in enumerate(
            ((100, 0), (110, 70), (65_519, 70), (65_520, 100)), 1
        ):
            await camera.show(bytes([size % 251]) * size, quality=quality)
            await viewer.send_json({"op": "credit", "frames": 1, "taken": number - 1 or None})
            await add(f"a frame of {size} bytes")
            if number == 1:
                first_credits = list(camera.of("credit"))
        await viewer.send_json({"op": "stream_request", "width": 640, "height": 480})
        await camera.wait_for("stream_request", width=640)
        await camera.wait_for("credit", taken=1)
    # Clock syncs are sent by the clock; a credit when the fastest viewer has taken a frame.
    transcript.add("relay to robot:", camera.of("clock_sync")[0] | {"t_ms": "<clock>"})
    taken = next(text for text in camera.of("credit") if text["taken"] == 1)
    for text in [*camera.of("stream_request"), *first_credits, taken]:
        transcript.add("relay to robot:", text)
    assert transcript == recorded


async def _refusal(http, case, url, **headers):
    async with http.get(url, headers=headers) as answer:
        problem = await answer.json(content_type=None)
        return f"{case}: {answer.status}", problem_line(answer.status, problem)


async def _ending(http, url, act, *, wants):
    """Connect, have `act` end that, and return how it ended."""
    async with http.ws_connect(url) as socket:
        if wants:
            await socket.send_json({"op": "stream_request"})
        done = act(socket)
        if done is not None:
            await done
        return await ending_of(socket)


async def test_how_viewers_connections_end(world, recorded):
    """The close code and reason of each way, and what is refused before the upgrade."""
    transcript = Transcript()

    async def end(case, act, *, wants=True):
        transcript.add(f"{case}:", await _ending(world.http, frames_url(world), act, wants=wants))

    transcript.add(*await _refusal(world.http, "no camera", frames_url(world, "x=1"), **UPGRADE))
    transcript.add(*await _refusal(world.http, "no upgrade", frames_url(world)))
    await end("never connected", lambda _: None, wants=False)
    robot = await world.robot("guard_off")
    camera = robot.frames
    for mode in ("no_service", "any_page", "full"):
        camera.mode = mode
        await end(mode, lambda _: None)
    camera.mode = "behaves"
    for text in [*BROKEN, '{"op":"credit"}']:
        shown = text if len(text) < 100 else f"{len(text)} characters"
        await end(shown, lambda s, t=text: s.send_str(t), wants="credit" not in text)
    connections = world.relay.relay.connections
    usual = connections.caps
    await until(lambda: connections.count("video") == 0, "all have left", WAIT_S)
    connections.caps = replace(usual, per_user=0)
    await end("too many", lambda _: None, wants=False)
    connections.caps = usual

    async def without_right(_):
        await camera.wait_for("stream_request")
        world.database.grants.clear()

    await end("rights ended", without_right)
    world.database.grants[1, 7] = "drive"
    await world.relay.relay.fleet.poll()
    # Its ports stay open, so that nothing but the session ends.
    robot.mode = "port_taken"
    await end("link lost", lambda _: robot.session.close())
    await robot.stop()
    stopping = []
    await world.robot("guard_off")
    stop = world.relay.relay.stop
    await end("relay stops", lambda _: stopping.append(asyncio.create_task(stop())))
    await stopping[0]
    assert transcript == recorded


class Service:
    """The agent's frames service in front of a camera."""

    def __init__(self, camera, http):
        self.camera = camera
        self.http = http
        rosbridge_url = f"ws://127.0.0.1:{free_port()}"
        self.service = FramesService(
            SourceSettings(camera.url, rosbridge_url, "web_video_server"), RosGraph(rosbridge_url)
        )

    async def start(self):
        self.url = f"http://127.0.0.1:{await self.service.start()}"

    async def connect(self, topic):
        url = f"{self.url}/robotether/frames?topic={topic}"
        return await self.http.ws_connect(url, max_msg_size=0)

    async def text(self, socket):
        """Wait for the next text, and take the frames that come before it."""
        async with asyncio.timeout(WAIT_S):
            while (message := await socket.receive()).type is aiohttp.WSMsgType.BINARY:
                await socket.send_json({"op": "credit", "frames": 1})
        return json.loads(message.data)


@pytest.fixture
async def service(monkeypatch):
    # Before a slow machine makes the agent try lower rates.
    monkeypatch.setattr(receiver, "STATUS_EVERY_S", 0.01)
    async with FakeVideoServer() as camera, timed_session() as http:
        made = Service(camera, http)
        await made.start()
        yield made
        await made.service.close()


async def test_agent_and_relay(service, recorded):
    """A clock sync, statuses, a frame of a camera that stamps them, and what is not the protocol."""
    transcript = Transcript(("sender_ms", "timestamp_ms", "fps", "sequence"))
    transcript.name(service.camera.port, "camera's port")
    # One quality and a long time: no step down, however slow this machine is.
    request = {"op": "stream_request", "quality_min": 40, "quality_max": 40, "latency_ms": 5000}
    request |= {"width": 320, "height": 240}
    async with await service.connect("/a") as socket:
        await socket.send_json({"op": "dance"})
        await socket.send_json({"op": "clock_sync", "t_ms": 81.25})
        transcript.add("agent:", await service.text(socket))
        await socket.send_json(request)
        transcript.add("agent, before a frame:", await service.text(socket))
        await socket.send_json({"op": "credit", "frames": 2, "taken": None})
        frames = []
        async with asyncio.timeout(WAIT_S):
            while len(frames) < 2:
                message = await socket.receive()
                if message.type is aiohttp.WSMsgType.BINARY:
                    frames.append(message.data)
        first, second = frames
        transcript.add("agent, a frame:", first[:4].hex(" "), header_of(first))
        assert header_of(second)["sequence"] > header_of(first)["sequence"] > 0
        # The comment behind a JPEG's start is the camera's count.
        transcript.add("  frame:", {"size": len(first), "begins": first[16:22].hex(" ")})
        await socket.send_json({"op": "credit", "frames": 2})
        # The codec is known when a frame has gone out, which may be after the first status.
        while (status := await service.text(socket))["codec"] is None:
            pass
        transcript.add("agent, when frames come:", status)
    transcript.add("camera is asked for:", service.camera.asked[0])
    service.camera.mode = "refuses"
    async with await service.connect("/b") as socket:
        await socket.send_json(request)
        await socket.send_json({"op": "credit", "frames": 2})
        while (status := await service.text(socket))["state"] != "down":
            pass
        transcript.add("agent, when its source is down:", status)
    for text in BROKEN:
        async with await service.connect("/b") as socket:
            await socket.send_str(text)
            shown = text if len(text) < 100 else f"{len(text)} characters"
            transcript.add(f"{shown}:", await ending_of(socket))
    assert transcript == recorded
