"""What runs on the robot in behind_video: an echoing WebSocket, and a camera that offers more than its uplink takes.

Started by behind_video inside the robot's namespace; ends with its stdin. The camera treats a viewer as
web_video_server does: one picture is under way to the kernel, those that come meanwhile are dropped. Its socket is the
kernel's default.
"""

from __future__ import annotations

import asyncio
import os
import sys
import time

from aiohttp import web

ROS_PORT, VIDEO_PORT = 9090, 8080
FRAMES_HZ = 15
OFFERED_BIT_S = 7e6
FRAME_BYTES = int(OFFERED_BIT_S / 8 / FRAMES_HZ)
BOUNDARY = b"--boundarydonotcross\r\n"
LENGTH = 24


def frame() -> bytes:
    """A picture that begins with the moment at which it was taken."""
    captured = f"{time.monotonic():.6f}".encode().ljust(LENGTH)
    jpeg = captured + bytes(FRAME_BYTES - LENGTH)
    head = b"Content-type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(jpeg)
    return head + jpeg + b"\r\n" + BOUNDARY


async def echo(request: web.Request) -> web.WebSocketResponse:
    """Send every message back."""
    socket = web.WebSocketResponse(compress=False)
    await socket.prepare(request)
    async for message in socket:
        await socket.send_str(message.data)
    return socket


async def show(_: asyncio.StreamReader, viewer: asyncio.StreamWriter) -> None:
    """Stream pictures to one viewer until it leaves."""
    viewer.transport.set_write_buffer_limits(high=0)
    viewer.write(b"HTTP/1.1 200 OK\r\n\r\n" + BOUNDARY)
    started = time.monotonic()
    number = 0
    try:
        while True:
            viewer.write(frame())
            await viewer.drain()
            # The next picture that the camera takes, not the one that was missed meanwhile.
            number = max(number, int((time.monotonic() - started) * FRAMES_HZ)) + 1
            await asyncio.sleep(started + number / FRAMES_HZ - time.monotonic())
    except ConnectionError:
        viewer.close()


async def main() -> None:
    """Serve until stdin ends."""
    app = web.Application()
    app.router.add_get("/", echo)
    runner = web.AppRunner(app, access_log=None, shutdown_timeout=0.1)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", ROS_PORT).start()
    camera = await asyncio.start_server(show, "127.0.0.1", VIDEO_PORT)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    await asyncio.to_thread(os.read, 0, 1)
    camera.close()
    await runner.cleanup()


if __name__ == "__main__":
    asyncio.run(main())
