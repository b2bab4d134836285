"""Rosbridge over real sockets: programs, cuts and clients that misbehave."""

import asyncio
import contextlib
import json
import sys
from pathlib import Path

import aiohttp
import pytest
import sim_client
from sim_client import SETTINGS, WAIT_S, SocketClient, until
from sim_robot.rosbridge.outbox import MESSAGES_LIMIT
from sim_robot.simulator import Simulator
from stopwatch import Stopwatch

ROUND_TRIP = Path(sim_client.__file__).with_name("roslibpy_round_trip.py")


async def test_roslibpy_round_trip(simulator: Simulator) -> None:
    """The real roslibpy finds topics, echoes, drives, and gets a service's failure."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, str(ROUND_TRIP), str(simulator.rosbridge.listener.port),
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


async def test_pose_comes_62_times_a_second(simulator: Simulator) -> None:
    """125 poses take 2 s."""
    async with SocketClient(simulator.rosbridge.listener.port) as client:
        await client.send(op="subscribe", topic="/pose")
        await client.receive()
        # A robot that was held up skips what it missed.
        with Stopwatch() as stopwatch:
            for _ in range(125):
                await client.receive()
        assert stopwatch.clock_s > 1.85
        assert stopwatch.s < 2.15


async def test_driving_moves_and_silence_stops(simulator: Simulator) -> None:
    """One command moves the robot by its speed for 1 s, and odometry says so."""
    async with SocketClient(simulator.rosbridge.listener.port) as client:
        await client.send(op="publish", topic="/cmd_vel", msg={"linear": {"x": 0.5}})
        await client.send(op="subscribe", topic="/odom")
        speeds = []
        while not speeds or speeds[-1] > 0:
            odom = (await client.receive())["msg"]
            speeds.append(odom["twist"]["twist"]["linear"]["x"])
        assert speeds[0] == 0.5
        assert odom["pose"]["pose"]["position"]["x"] == pytest.approx(0.5, abs=0.03)


async def test_plain_get_is_400(simulator: Simulator) -> None:
    """A browser that opens the port is told to upgrade."""
    url = f"http://127.0.0.1:{simulator.rosbridge.listener.port}/"
    async with aiohttp.ClientSession() as http, http.get(url) as answer:
        assert answer.status == 400
        assert "WebSocket" in await answer.text()


async def test_client_that_never_reads_is_bounded_and_hurts_nobody(simulator: Simulator) -> None:
    """Its queue stays at the limit, the oldest go, and another client is served."""
    port = simulator.rosbridge.listener.port
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


async def test_client_that_asks_and_never_reads_is_cut_off(simulator: Simulator) -> None:
    """When answers pile up, that connection ends."""
    async with SocketClient(simulator.rosbridge.listener.port) as client:
        transport = client.socket._response.connection.transport
        transport.pause_reading()
        call = json.dumps({"op": "call_service", "service": "/rosapi/" + "x" * 5000})

        async def ask() -> None:
            while True:
                await client.socket.send_str(call)

        with pytest.raises((ConnectionError, aiohttp.ClientError)):
            await asyncio.wait_for(ask(), 20)


async def test_message_over_the_limit_ends_that_connection_only(simulator: Simulator) -> None:
    """More than 10 MB ends it, with 1009 if the client still listens; the neighbour goes on."""
    port = simulator.rosbridge.listener.port
    async with SocketClient(port) as big, SocketClient(port) as other:
        with contextlib.suppress(ConnectionError):  # the end may come while it is still sending
            await big.socket.send_str('{"op": "publish", "data": "' + "x" * 10_000_000 + '"}')
        await big.socket.receive(timeout=WAIT_S)
        assert big.socket.close_code in (1009, 1006)
        await other.ready()


async def test_broken_message_leaves_the_connection_alive(simulator: Simulator) -> None:
    """Rubbish gets an error, the next message works."""
    async with SocketClient(simulator.rosbridge.listener.port) as client:
        await client.socket.send_bytes(b"\xff\x00")
        assert (await client.receive())["level"] == "error"
        await client.ready()


async def test_topics_go_with_a_cut_connection(simulator: Simulator) -> None:
    """A client that vanishes leaves no topic behind."""
    async with SocketClient(simulator.rosbridge.listener.port) as client:
        await client.send(op="advertise", topic="/mine", type="std_msgs/String")
        await client.ready()
        assert "/mine" in simulator.graph.bus.topics()
        client.socket._response.connection.transport.abort()
        await until("topic gone", lambda: "/mine" not in simulator.graph.bus.topics())


async def test_stop_closes_with_going_away() -> None:
    """When the robot is switched off, its clients see 1001."""
    async with Simulator(SETTINGS) as simulator:
        client = await SocketClient(simulator.rosbridge.listener.port).__aenter__()
        await client.ready()
        closing = asyncio.create_task(client.socket.receive(timeout=WAIT_S))
        await asyncio.sleep(0)
    assert (await closing).type is aiohttp.WSMsgType.CLOSE
    assert client.socket.close_code == 1001
    await client.__aexit__(None, None, None)
