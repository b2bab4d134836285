"""What runs on the robot in behind_video, started in the robot's namespace; ends with its stdin.

The first line of its input says what. `{}`: an echoing WebSocket that has a large map, a laser and a lidar, and a
camera that offers more than the uplink takes. It treats a viewer as web_video_server does: one frame is under way to
the kernel, those that come meanwhile are dropped. Otherwise the two SSH connections as the agent makes them, with the
video proxy and the topics service; the line has the arguments of `tunnels`, whose folder has `key` and `known_hosts`.
"""

from __future__ import annotations

import asyncio
import getpass
import json
import logging
import os
import socket
import sys
import time
from contextlib import suppress
from pathlib import Path

from aiohttp import web
from clips import CLIPS, SIZES, jpeg_of
from paper.programs import write_line
from robotether_agent.net.server_dialer import SshAddress
from robotether_agent.rosbridge import RosGraph
from robotether_agent.topics_service import TopicsService
from robotether_agent.tunnel.openssh import Forward, SshFiles
from robotether_agent.tunnel.tunnel import Tunnel
from robotether_agent.video.frames_service import FramesService
from robotether_agent.video.sources import SourceSettings
from robotether_agent.video.video_proxy import LocalService, VideoProxy
from robotether_common.session import Kind
from robotether_common.topics import PATH

ROS_PORT, VIDEO_PORT = 9090, 8080
FRAMES_HZ = 15
OFFERED_BIT_S = 7e6
FRAME_BYTES = int(OFFERED_BIT_S / 8 / FRAMES_HZ)
ANSWER = (
    b"HTTP/1.1 200 OK\r\nConnection: close\r\n"
    b"Content-Type: multipart/x-mixed-replace;boundary=boundarydonotcross\r\n\r\n"
)
BOUNDARY = b"--boundarydonotcross\r\n"
# Of the camera's JPEGs, which must fit into FRAME_BYTES.
QUALITY = 80
# As rosbridge writes a map of 1500 x 1500 cells.
MAP_BYTES = 5_000_000
MAP = '{"op": "publish", "topic": "/map", "msg": {"data": [' + "-1," * (MAP_BYTES // 3) + "0]}}"
SCAN_HZ, CLOUD_HZ = 40, 2
CLOUD_BYTES = 1_000_000
SCAN = '{"op": "publish", "topic": "/scan", "msg": {"ranges": [' + "1.234, " * 360 + "0]}}"
CLOUD = '{"op": "publish", "topic": "/points", "msg": {"data": "' + "x" * CLOUD_BYTES + '"}}'
# What a subscription brings, and how often; 0: once.
TOPICS = {"/map": (MAP, 0), "/scan": (SCAN, SCAN_HZ), "/points": (CLOUD, CLOUD_HZ)}
# Of the media connection, in place of what the agent would choose.
CONGESTION_CONTROL = b"cubic"


class PanningCamera:
    """A camera that pans over a texture; a codec may make less of its frames than of others."""

    def __init__(self) -> None:
        clip = next(clip for clip in CLIPS if clip.name == "slow")
        self._jpegs = [jpeg_of(frame, QUALITY) for frame in clip.frames(SIZES[0], FRAMES_HZ)]

    def part(self, number: int) -> bytes:
        """Return a part with the time at which it is taken; all are as long, by zeros behind the JPEG's end."""
        # To and fro, so that no frame is far from the one before.
        place = number % (2 * len(self._jpegs) - 2)
        jpeg = self._jpegs[min(place, 2 * len(self._jpegs) - 2 - place)]
        head = (
            "Content-type: image/jpeg\r\n"
            f"X-Timestamp: {time.time():.6f}\r\n"
            f"Content-Length: {FRAME_BYTES}\r\n\r\n"
        )
        return head.encode() + jpeg.ljust(FRAME_BYTES, b"\0") + b"\r\n" + BOUNDARY


async def echo(request: web.Request) -> web.WebSocketResponse:
    socket = web.WebSocketResponse(compress=False)
    await socket.prepare(request)
    async with asyncio.TaskGroup() as publishing:
        tasks = []
        async for message in socket:
            if message.data.startswith('{"op"'):
                topic = json.loads(message.data)["topic"]
                tasks.append(publishing.create_task(publish(socket, *TOPICS[topic])))
            else:
                await socket.send_str(message.data)
        for task in tasks:
            task.cancel()
    return socket


async def publish(socket: web.WebSocketResponse, message: str, rate_hz: float) -> None:
    """Send a topic's messages, each at its time, until the subscriber leaves."""
    started = time.monotonic()
    with suppress(ConnectionError):
        await socket.send_str(message)
        number = 0
        while rate_hz:
            number += 1
            await asyncio.sleep(max(0.0, started + number / rate_hz - time.monotonic()))
            await socket.send_str(message)


async def show(camera: PanningCamera, viewer: asyncio.StreamWriter) -> None:
    """Stream frames to one viewer until it leaves."""
    viewer.transport.set_write_buffer_limits(high=0)
    viewer.write(ANSWER + BOUNDARY)
    started = time.monotonic()
    number = 0
    try:
        while True:
            viewer.write(camera.part(number))
            await viewer.drain()
            # The next frame that the camera takes, not the one that was missed meanwhile.
            number = max(number, int((time.monotonic() - started) * FRAMES_HZ)) + 1
            await asyncio.sleep(started + number / FRAMES_HZ - time.monotonic())
    except ConnectionError:
        viewer.close()


async def services() -> None:
    app = web.Application()
    app.router.add_get("/", echo)
    runner = web.AppRunner(app, access_log=None, shutdown_timeout=0.1)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", ROS_PORT).start()
    camera = PanningCamera()
    server = await asyncio.start_server(
        lambda _, viewer: show(camera, viewer), "127.0.0.1", VIDEO_PORT
    )
    await until_stdin_ends()
    server.close()
    await runner.cleanup()


async def until_stdin_ends() -> None:
    write_line({"ready": True})
    await asyncio.to_thread(sys.stdin.read)


async def opened(folder: Path, target: SshAddress, kind: Kind) -> Tunnel:
    files = SshFiles((folder / "key",), folder / "known_hosts", folder / f"{kind}.sock")
    tunnel = await Tunnel.open(target, files, kind)
    # The session command's line.
    await tunnel.lines_in.readline()
    return tunnel


async def tunnels(folder: str, host: str, port: int, ros_port: int, video_port: int) -> None:
    target = SshAddress(host, port, getpass.getuser())
    rosbridge, camera = f"ws://127.0.0.1:{ROS_PORT}", f"http://127.0.0.1:{VIDEO_PORT}"
    topics = TopicsService(rosbridge)
    source_settings = SourceSettings(camera, rosbridge, "web_video_server")
    media_service = FramesService(
        source_settings, RosGraph(rosbridge), video_encoder="auto", routes={PATH: topics.answer}
    )
    proxy = VideoProxy(camera, LocalService(await media_service.start()))
    proxy_port = await proxy.start()
    session = await opened(Path(folder), target, "session")
    await session.add(Forward(ros_port, "127.0.0.1", ROS_PORT))
    media = await opened(Path(folder), target, "media")
    if media.socket is not None:
        media.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, CONGESTION_CONTROL)
    proxy.use(media.socket)
    await media.add(Forward(video_port, "127.0.0.1", proxy_port))
    await until_stdin_ends()
    await proxy.close()
    await media_service.close()
    await topics.close()
    await asyncio.gather(session.close(), media.close())


if __name__ == "__main__":
    logging.basicConfig(level=os.environ.get("LOG_LEVEL", "WARNING"))
    order = json.loads(sys.stdin.readline())
    asyncio.run(tunnels(**order) if order else services())
