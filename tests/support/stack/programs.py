"""An operator's program in asyncio: tickets and rosbridge WebSockets through the running stack."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from typing import Any, TypeVar

import aiohttp
from local_network import insecure_tls
from stack import Stack

Result = TypeVar("Result")
# Time limit for the first subscription, which opens the media connection.
OPEN_WITHIN_S = 20.0
ECHO = "/test_echo"


class Program:
    def __init__(self, stack: Stack, token: str) -> None:
        self.stack = stack
        self.headers = {"Authorization": f"Bearer {token}"}

    def ticket(self, robot: str, mode: str = "drive") -> str:
        status, answer = self.stack.request(
            "POST", "/api/v1/tickets", {"robot": robot, "mode": mode}, self.headers
        )
        assert status == 201, answer
        return str(answer["ticket"])

    def url(self, robot: str, ticket: str | None = None) -> str:
        """A robot's rosbridge, with a ticket, by default one to drive it."""
        return f"{self.stack.url}/robots/{robot}/ros?ticket={ticket or self.ticket(robot)}"

    @asynccontextmanager
    async def connect(
        self, robot: str, mode: str = "drive", ticket: str | None = None, **options: Any
    ) -> AsyncIterator[aiohttp.ClientWebSocketResponse]:
        ticket = ticket or await asyncio.to_thread(self.ticket, robot, mode)
        url = self.url(robot, ticket)
        async with (
            aiohttp.ClientSession() as http,
            http.ws_connect(url, ssl=insecure_tls(), max_msg_size=0, **options) as socket,
        ):
            yield socket


async def echo(socket: aiohttp.ClientWebSocketResponse, text: str, seconds: float = 10) -> str:
    await socket.send_json({"op": "publish", "topic": ECHO, "msg": {"data": text}})
    async with asyncio.timeout(seconds):
        while True:
            message = json.loads(await socket.receive_str())
            if message.get("op") == "publish" and message["topic"] == ECHO:
                return str(message["msg"]["data"])


async def drive_on(
    socket: aiohttp.ClientWebSocketResponse, doing: Coroutine[Any, Any, Result]
) -> Result:
    """Drive while something else is done: a driver who reads nothing answers no ping, and is gone."""
    task = asyncio.create_task(doing)
    try:
        while not task.done():
            assert await echo(socket, "driving on") == "driving on"
            await asyncio.sleep(0.1)
    finally:
        # Also when the drive fails: what goes on meanwhile would come after what puts it right again.
        await asyncio.wait({task})
    return await task


async def open_echo(socket: aiohttp.ClientWebSocketResponse) -> None:
    """Advertise and subscribe a std_msgs/String topic, and wait until the robot answers: then the drive has begun."""
    await socket.send_json({"op": "advertise", "topic": ECHO, "type": "std_msgs/String"})
    await socket.send_json({"op": "subscribe", "topic": ECHO, "type": "std_msgs/String"})
    assert await echo(socket, "open", OPEN_WITHIN_S) == "open"


async def drive_forward(program: Program, robot: str) -> float:
    """Send a Twist through the server and return how far the simulated robot went, in metres; about 0.5."""
    async with program.connect(robot) as socket:
        await socket.send_json({"op": "subscribe", "topic": "/pose", "type": "turtlesim/Pose"})
        await socket.send_json(
            {"op": "advertise", "topic": "/cmd_vel", "type": "geometry_msgs/Twist"}
        )
        start = await _x_of_pose(socket)
        twist = {
            "linear": {"x": 1.0, "y": 0.0, "z": 0.0},
            "angular": {"x": 0.0, "y": 0.0, "z": 0.0},
        }
        end = time.monotonic() + 15
        x = start
        while time.monotonic() < end and x - start < 0.5:
            # Again and again, as a driver does: the guard stops a robot whose commands have stopped.
            await socket.send_json({"op": "publish", "topic": "/cmd_vel", "msg": twist})
            x = await _x_of_pose(socket)
        return x - start


async def _x_of_pose(socket: aiohttp.ClientWebSocketResponse) -> float:
    """Return x of the next pose, in metres; a command that a busy machine made too old is dropped, and said so."""
    of_relay, of_guard = " ms old, over ", "it is not of the last "
    while True:
        message = json.loads(await asyncio.wait_for(socket.receive_str(), 10))
        is_complaint = message["op"] == "status"
        if is_complaint and (of_relay in message["msg"] or of_guard in message["msg"]):
            continue
        assert message["op"] == "publish", message
        return float(message["msg"]["x"])
