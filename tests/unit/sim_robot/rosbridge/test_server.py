"""Rosbridge over real sockets: programs, cuts and clients that misbehave."""

import asyncio
import itertools
import json
import sys
import time
from pathlib import Path

import pytest
import sim_client
from sim_client import until
from sim_robot.graph import TopicMessage
from sim_robot.kinematics import STEP_S
from sim_robot.rosbridge.client import MESSAGES_LIMIT, ThrottledQueue
from sim_robot.simulator import Simulator
from timed_websocket import SocketClient

ROUND_TRIP = Path(sim_client.__file__).with_name("roslibpy_round_trip.py")


async def test_roslibpy_round_trip(simulator: Simulator) -> None:
    """The real roslibpy finds topics, echoes, drives, and gets a service's failure."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, str(ROUND_TRIP), str(simulator.rosbridge.port),
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    out, errors = await asyncio.wait_for(process.communicate(), 30)
    assert process.returncode == 0, errors.decode()
    seen = json.loads(out)
    assert {"/cmd_vel", "/pose", "/odom", "/camera/image_raw"} <= set(seen["topics"])
    assert seen["odom_type"] == "nav_msgs/msg/Odometry"
    assert seen["twists"] == ["/cmd_vel"]
    assert "/sim_robot" in seen["nodes"]
    assert seen["echoes"] == [{"data": str(number)} for number in range(20)]
    assert seen["poses"][-1]["x"] > seen["poses"][0]["x"]
    assert "Service /nope does not exist" in seen["unknown"]


async def test_driving_moves_and_silence_stops(simulator: Simulator) -> None:
    """One command moves the robot by its speed for 1 s, and odometry says so."""
    robot = simulator.robot
    # By the time that it has lived through: while this process stands still, it leaves out steps.
    robot._clock = lambda: robot.steps * STEP_S
    async with SocketClient(simulator.rosbridge.port) as client:
        await client.send(op="publish", topic="/cmd_vel", msg={"linear": {"x": 0.5}})
        await client.send(op="subscribe", topic="/odom")
        speeds = []
        while not speeds or speeds[-1] > 0:
            odom = (await client.receive())["msg"]
            speeds.append(odom["twist"]["twist"]["linear"]["x"])
        assert speeds[0] == 0.5
        assert odom["pose"]["pose"]["position"]["x"] == pytest.approx(0.5, abs=0.03)


async def test_client_that_never_reads_is_bounded_and_hurts_nobody(simulator: Simulator) -> None:
    """Its queue stays at the limit, the oldest go, and another client is served."""
    port = simulator.rosbridge.port
    async with SocketClient(port) as deaf, SocketClient(port) as other:
        await deaf.send(op="subscribe", topic="/big", type="std_msgs/String")
        await deaf.ready()
        transport = deaf.socket._response.connection.transport  # no public way to stop reading
        transport.pause_reading()
        (client,) = [c for c in _callbacks(simulator, "/big") if c is not None]
        await until("queue is full and drops", lambda: _flood(simulator) and client.dropped > 0)
        assert len(client) <= MESSAGES_LIMIT
        await other.ready()
        transport.resume_reading()


def _callbacks(simulator: Simulator, topic: str) -> list:
    """The outboxes of a topic's subscribers."""
    offers = simulator.graph.bus._topics[topic].subscribers.values()
    return [offer.__self__._send.args[0].outbox for offer in offers]


def _flood(simulator: Simulator) -> bool:
    for _ in range(50):
        simulator.graph.bus.publish("/big", {"data": "x" * 50_000})
    return True


async def test_broken_message_leaves_the_connection_alive(simulator: Simulator) -> None:
    """Rubbish gets an error, the next message works."""
    async with SocketClient(simulator.rosbridge.port) as client:
        await client.socket.send_bytes(b"\xff\x00")
        assert (await client.receive())["level"] == "error"
        await client.ready()


class Sink:
    """A delivery and what it sent, with the moments."""

    def __init__(self, throttle_ms: int, queue_length: int) -> None:
        self.sent: list[int] = []
        self.moments: list[float] = []
        self.delivery = ThrottledQueue(self._take)
        self.delivery.configure(throttle_ms, queue_length)

    def offer(self, *numbers: int) -> None:
        """Offer messages at once."""
        for number in numbers:
            self.delivery.offer(TopicMessage("/a", "std_msgs/Int32", {"data": number}))

    def _take(self, message: TopicMessage) -> None:
        self.sent.append(message.values["data"])
        self.moments.append(time.monotonic())


async def test_queue_delays_and_drops_the_oldest() -> None:
    """With a queue of 2, the newest two wait and go out one a throttle time."""
    sink = Sink(40, 2)
    sink.offer(1, 2, 3, 4, 5)
    await until("queue sent", lambda: len(sink.sent) == 3)
    assert sink.sent == [1, 4, 5]
    gaps = [b - a for a, b in itertools.pairwise(sink.moments)]
    assert min(gaps) > 0.035
