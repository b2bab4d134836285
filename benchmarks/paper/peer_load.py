"""How much comes from a robot on any of the ways that are compared, and what carrying it costs in processor time.

A program on the robot publishes messages as the operator asks for them, always so many at a time that the link never
waits for it and no queue on the way runs over: some ways drop what does not fit, others keep it without a bound.
"""

from __future__ import annotations

import asyncio
import json
import random
import time
from contextlib import AsyncExitStack

import aiohttp
from relay_server import until

from paper.peer_echo import LAST_S, MESSAGE_TYPE, Socket, connected, http_of, new_topic, stop
from paper.peer_program import cpu_between, cpu_s
from paper.peer_transport import Transport, connector_in

# More than the link and the queue before it hold.
LOAD_BYTES, LOADS_AT_ONCE = 48 * 1024, 12
Costs = tuple[dict[int, float], dict[int, float]]


class Load:
    """The program on the robot, and the operator who asks; they run inside `async with`."""

    def __init__(self, robot: Socket, operator: Socket) -> None:
        self._more, self._load = new_topic("more"), new_topic("load")
        self._robot, self._operator = robot, operator
        # What no compression on the way makes much smaller.
        self._data = random.Random(1).randbytes(LOAD_BYTES // 2).hex()
        self.received_bytes = 0

    async def __aenter__(self) -> Load:
        ends = ((self._robot, self._load, self._more), (self._operator, self._more, self._load))
        for socket, out, into in ends:
            await socket.send_json({"op": "advertise", "topic": out, "type": MESSAGE_TYPE})
            await socket.send_json({"op": "subscribe", "topic": into, "type": MESSAGE_TYPE})
        self._tasks = [asyncio.ensure_future(one) for one in (self._publish(), self._ask())]
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in self._tasks:
            await stop(task)

    def check(self) -> None:
        """Raise what ended it, if something did."""
        for task in self._tasks:
            if task.done():
                task.result()

    async def _publish(self) -> None:
        text = json.dumps({"op": "publish", "topic": self._load, "msg": {"data": self._data}})
        while True:
            await self._robot.receive_str()
            await self._robot.send_str(text)

    async def _ask(self) -> None:
        more = {"op": "publish", "topic": self._more, "msg": {"data": ""}}
        for _ in range(LOADS_AT_ONCE):
            await self._operator.send_json(more)
        while True:
            text = await self._operator.receive_str()
            if len(text) > LOAD_BYTES:
                self.received_bytes += len(text)
                await self._operator.send_json(more)


async def throughput(transport: Transport, seconds: float, settle_s: float) -> dict[str, float]:
    """Payload in bit/s that comes from the robot, and processor seconds a MB of it at the robot's and server's side."""
    async with AsyncExitStack() as stack:
        http = await stack.enter_async_context(http_of(transport))
        local = aiohttp.ClientSession(connector=connector_in(transport.inside))
        await stack.enter_async_context(local)
        url = await asyncio.to_thread(transport.ros_url)
        operator = await stack.enter_async_context(connected(http, url))
        robot = await stack.enter_async_context(connected(local, transport.local_ros_url()))
        load = await stack.enter_async_context(Load(robot, operator))
        await until(lambda: load.received_bytes or load.check(), f"load, {transport.title}", LAST_S)
        await asyncio.sleep(settle_s)
        before = await asyncio.to_thread(costs, transport)
        started, received = time.monotonic(), load.received_bytes
        await asyncio.sleep(seconds)
        lasted_s, carried = time.monotonic() - started, load.received_bytes - received
        after = await asyncio.to_thread(costs, transport)
        load.check()
    return {"payload_bit_s": carried * 8 / lasted_s, **per_mb(before, after, carried)}


def costs(transport: Transport) -> Costs:
    """Processor seconds so far of the robot's and the server's side, by process."""
    return cpu_s(transport.robot_pids()), cpu_s(transport.server_pids())


def per_mb(before: Costs, after: Costs, carried_bytes: int) -> dict[str, float]:
    """What was spent between two looks, for each 10^6 bytes."""
    robot, server = (cpu_between(*pair) for pair in zip(before, after, strict=True))
    mb = carried_bytes / 1e6
    return {"robot_cpu_s_per_mb": robot / mb, "server_cpu_s_per_mb": server / mb}
