"""What recording costs the recorder's processor. Used by `bench`; needs no demo.

The recorder runs in a process of its own with its rows in memory. This process stands in for the relay, so that nothing
else counts: it speaks its three channels at the rates of a robot that is driven.
"""

from __future__ import annotations

import asyncio
import json
import os
import tempfile
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

import aiohttp
from aiohttp import web
from paper.costs import trees_cpu_s
from paper.programs import LineProgram, read_line
from report import Row, Section
from robotether_agent.tasks import first_of
from robotether_common.frames import HEADER, KEY
from robotether_server.db.recordings import Progress, RecordableRobot, RecordingCause, RecordingRow
from robotether_server.recorder import relay_client
from robotether_server.recorder.relay_client import RelayClient
from robotether_server.recorder.service import RecorderService
from robotether_server.recorder.store import RecorderStore
from robotether_server.settings.server import DatabaseSettings, RecorderSettings, TicketSettings

ROBOTS, CAMERAS, FPS = 10, ("/front", "/rear"), 15
# Number of the codec, and the size of a frame of 640x480.
CODECS = {"JPEG": (1, 30_000), "H.264": (2, 8_000)}
SECONDS, SETTLE_S = 20.0, 5.0
AIM_PERCENT = 30
# What rosapi says of the topics' types.
VECTOR = ("geometry_msgs/Vector3", dict.fromkeys("xyz", ("float64", -1)))
TWIST = ("geometry_msgs/Twist", dict.fromkeys(("linear", "angular"), (VECTOR[0], -1)))
SCAN = ("demo/Scan", {"stamp": ("time", -1), "ranges": ("float32", 0)})
AHEAD = {"x": 0.5, "y": 0.0, "z": 0.0}
# By topic: its type, its rate as a robot's rosbridge throttles it, and a message.
TOPICS: dict[str, tuple[str, int, dict[str, object]]] = {
    **{
        name: (TWIST[0], rate, {"linear": AHEAD, "angular": AHEAD})
        for name, rate in (("/odom", 10), ("/imu", 10), ("/tf", 30))
    },
    "/scan": (SCAN[0], 10, {"stamp": {"sec": 1, "nanosec": 2}, "ranges": [1.234] * 360}),
}
COMMAND = {
    "stamp": {"sec": 1, "nanosec": 2},
    "topic": "/cmd_vel",
    "person": "ann",
    "fence": 1,
    "age_ms": 40.0,
    "outcome": "sent",
    "speed_m_s": 0.5,
    "turn_rad_s": 0.1,
    "message": '{"linear":{"x":0.5},"angular":{"z":0.1}}',
    "seen_cameras": list(CAMERAS),
    "seen_frames": [1, 2],
}
CONTROL = {
    "stamp": {"sec": 1, "nanosec": 2},
    "online": True,
    "driver": "ann",
    "fence": 1,
    "stopped": False,
    "stopped_by": "",
    "stop_confirmed": False,
    "guard": "ready",
}


class StandInRelay:
    def __init__(self, codec: int, frame_bytes: int) -> None:
        self._codec = codec
        self._frame = os.urandom(frame_bytes)
        self.frames = self.messages = 0

    async def follow(self, request: web.Request) -> web.StreamResponse:
        socket = await opened(request)
        texts = [
            (self._event(number, "control", CONTROL), self._event(number, "commands", COMMAND))
            for number in range(1, ROBOTS + 1)
        ]
        for control, _ in texts:
            await socket.send_str(control)

        async def send() -> None:
            for control, command in texts:
                # The recorder takes the first ones of robots that it does not follow yet for nobody's.
                await socket.send_str(command if self.frames else control)

        await at_rate(20, send)
        return socket

    async def rosbridge(self, request: web.Request) -> web.StreamResponse:
        socket = await opened(request)
        async with asyncio.TaskGroup() as group:
            async for message in socket:
                call = json.loads(message.data)
                if call["op"] == "call_service":
                    await socket.send_str(json.dumps(answer(call)))
                elif call["op"] == "subscribe":
                    _, rate, msg = TOPICS[call["topic"]]
                    text = json.dumps({"op": "publish", "topic": call["topic"], "msg": msg})
                    group.create_task(self._publish(socket, text, rate))
        return socket

    async def show(self, request: web.Request) -> web.StreamResponse:
        socket = await opened(request)
        await socket.receive()
        sender_ms = time.monotonic() * 1000
        await socket.send_json({"op": "clock_sync", "t_ms": 0, "sender_ms": sender_ms})

        async def send() -> None:
            self.frames += 1
            head = HEADER.pack(self._codec, KEY, 50, self.frames, time.monotonic() * 1000)
            await socket.send_bytes(head + self._frame)

        async with asyncio.TaskGroup() as group:
            group.create_task(at_rate(FPS, send))
            async for _ in socket:
                pass
        return socket

    async def _publish(self, socket: web.WebSocketResponse, text: str, rate: float) -> None:
        async def send() -> None:
            self.messages += 1
            await socket.send_str(text)

        await at_rate(rate, send)

    @staticmethod
    def _event(robot_id: int, topic: str, message: dict[str, object]) -> str:
        return json.dumps({"robot_id": robot_id, "topic": topic, "message": message})


async def opened(request: web.Request) -> web.WebSocketResponse:
    socket = web.WebSocketResponse(compress=False)
    await socket.prepare(request)
    return socket


async def at_rate(rate: float, work: Callable[[], Awaitable[None]]) -> None:
    due = time.monotonic()
    try:
        while True:
            await work()
            due += 1 / rate
            await asyncio.sleep(max(0.0, due - time.monotonic()))
    except ConnectionError:
        return


def answer(call: dict[str, object]) -> dict[str, object]:
    values: dict[str, object] = {
        "topics": list(TOPICS),
        "types": [kind for kind, _, _ in TOPICS.values()],
        "typedefs": [
            {
                "type": kind,
                "fieldnames": list(fields),
                "fieldtypes": [field_type for field_type, _ in fields.values()],
                "fieldarraylen": [length for _, length in fields.values()],
            }
            for kind, fields in (VECTOR, TWIST, SCAN)
        ],
    }
    return {"op": "service_response", "id": call["id"], "values": values, "result": True}


class RowsInMemory(RecorderStore):
    def __init__(self) -> None:
        self._rows = 0

    async def read(self) -> tuple[list[RecordingRow], list[RecordableRobot]]:
        numbers = range(1, ROBOTS + 1)
        return [], [RecordableRobot(at, f"robot{at}", "always", CAMERAS) for at in numbers]

    async def add(self, robot: RecordableRobot, cause: RecordingCause, started_at: object) -> int:
        self._rows += 1
        return self._rows

    async def write_progress(self, progress: dict[int, Progress]) -> None:
        pass

    def end(self, recording_end: object) -> None:
        pass

    async def flush(self) -> None:
        pass


async def record() -> None:
    order = await read_line()
    relay_client.PUBLIC_PORT = relay_client.INSIDE_PORT = order["port"]
    database = DatabaseSettings("nowhere", 1, "none", "none", "none")
    who = (database, TicketSettings("k" * 40, 30), "main", "127.0.0.1")
    settings = RecorderSettings(*who, Path(order["folder"]), 10**12, 0, 10**7, "info")
    async with aiohttp.ClientSession() as session:
        recorder = RecorderService(settings, RelayClient(settings, session), RowsInMemory())
        await first_of(recorder.run(), read_line())


async def run_codec(name: str, seconds: float) -> Row:
    relay = StandInRelay(*CODECS[name])
    app = web.Application()
    app.router.add_get("/recorder", relay.follow)
    app.router.add_get("/robots/{name}/ros", relay.rosbridge)
    app.router.add_get("/robots/{name}/video/frames", relay.show)
    runner = web.AppRunner(app, access_log=None, shutdown_timeout=0.1)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", 0).start()
    try:
        with (
            tempfile.TemporaryDirectory() as folder,
            tempfile.NamedTemporaryFile() as log,
            LineProgram("recording", Path(log.name)) as recorder,
        ):
            recorder.send({"port": runner.addresses[0][1], "folder": folder})
            await asyncio.sleep(SETTLE_S)
            began_s, frames, messages = time.monotonic(), relay.frames, relay.messages
            [used_s], size = trees_cpu_s([recorder.pid]), size_of(folder)
            await asyncio.sleep(seconds)
            lasted_s = time.monotonic() - began_s
            return {
                "codec": name,
                "frames/s": (relay.frames - frames) / lasted_s,
                "messages/s": (relay.messages - messages) / lasted_s,
                "MB/s": (size_of(folder) - size) / lasted_s / 1e6,
                "recorder, % of a core": (trees_cpu_s([recorder.pid])[0] - used_s) / lasted_s * 100,
            }
    finally:
        await runner.cleanup()


def size_of(folder: str) -> int:
    return sum(path.stat().st_size for path in Path(folder).iterdir())


def measure(seconds: float = SECONDS) -> Section:
    text = (
        f"{ROBOTS} robots with {len(CAMERAS)} cameras of {FPS} frames a second each, four topics and 20 commands a "
        f"second, recorded for {seconds:g} s.\n\nAim: under {AIM_PERCENT} % of a core."
    )
    rows = [asyncio.run(run_codec(name, seconds)) for name in CODECS]
    return Section("What recording costs the recorder", text, rows)


if __name__ == "__main__":
    asyncio.run(record())
