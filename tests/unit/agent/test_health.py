"""The probes of the robot's services against real servers, and whom these services answer."""

import asyncio
import os
import resource
import socket
import subprocess
from contextlib import ExitStack
from itertools import chain, repeat
from pathlib import Path
from unittest.mock import AsyncMock, Mock

import namespaces
import pytest
from fake_rosbridge import FakeRosbridge
from local_network import free_port
from robotether_agent import health as health_module
from robotether_agent.exposure import ADDRESS_ADVICE, FIREWALL_ADVICE, exposed_at, rosbridge_advice
from robotether_agent.health import Health
from robotether_agent.video import sources as sources_module
from robotether_agent.video.sources import SourceSettings
from tcp_service import TcpService

EVERY_S = 0.1


@pytest.fixture
def watch(make_graph, spawn):
    def start(rosbridge_url, video_url, *more):
        settings = SourceSettings(video_url, rosbridge_url, *more)
        health = Health(settings, make_graph(rosbridge_url), every_s=EVERY_S)
        spawn(health.run())
        return health

    return start


async def until(health, reached):
    async def follow():
        report = health.report
        while not reached(report):
            report = await health.changed(report)
        return report

    return await asyncio.wait_for(follow(), 10)


async def test_both_ok_over_one_held_handshake(watch, services, monkeypatch, caplog):
    """No look takes a handshake of its own; one that a busy machine lost is said to be lost."""
    monkeypatch.setattr("robotether_agent.rosbridge.ANSWER_WITHIN_S", 0.1)
    health = watch(services.ws_url, services.url)
    report = await until(health, lambda report: report.ros == report.video == "ok")
    assert report.detail == ""
    services.video_status = 500
    await until(health, lambda report: report.video == "down")
    services.video_status = 200
    await until(health, lambda report: report.video == "ok")
    # Of some that were lost there was none.
    assert services.handshakes <= 2 + caplog.text.count("[rosbridge_down]")


async def test_the_time_without_an_answer_is_said(watch, services, monkeypatch):
    health = watch(services.ws_url, services.url)
    await until(health, lambda report: report.ros == "ok")
    monkeypatch.setattr("aiohttp.web.WebSocketResponse.pong", AsyncMock())
    report = await until(health, lambda report: report.ros == "down")
    assert report.ros_detail.endswith(f"does not answer: no answer in {EVERY_S / 2:g} s")


async def test_a_rosbridge_that_closes_at_once_is_never_ok(watch, services, monkeypatch, caplog):
    at_once = AsyncMock(side_effect=StopAsyncIteration)
    monkeypatch.setattr("aiohttp.web.WebSocketResponse.__anext__", at_once)
    health = watch(services.ws_url, services.url)
    report = await until(health, lambda report: report.ros == "down")
    assert report.ros_detail.endswith("it closed the connection")
    assert f"rosbridge at {services.ws_url} answers" not in caplog.messages


IMAGES = {"/camera/image_raw/compressed": "sensor_msgs/msg/CompressedImage"}


@pytest.fixture
def nowhere():
    return f"http://127.0.0.1:{free_port()}"


RAW = {"/camera/image_raw": "sensor_msgs/Image"}


@pytest.mark.parametrize(("topics", "has_pyav"), [(IMAGES, False), (RAW, True)])
async def test_video_comes_from_rosbridge_while_no_server_answers(
    watch, nowhere, monkeypatch, topics, has_pyav
):
    monkeypatch.setattr(health_module, "SELDOM", 2)
    monkeypatch.setattr(sources_module, "has_pyav", lambda: has_pyav)
    async with FakeRosbridge({} if has_pyav else RAW) as robot:
        health = watch(robot.url, nowhere)
        only_server = watch(robot.url, nowhere, "web_video_server")
        for item in (health, only_server):
            report = await until(item, lambda report: report.video == "down" and report.ros == "ok")
            assert "web_video_server at" in report.video_detail
        robot.topics = topics
        await until(health, lambda report: report.video == "ok")
        assert only_server.report.video == "down"


async def test_video_of_rosbridge_alone(watch, services, monkeypatch):
    monkeypatch.setattr(health_module, "SELDOM", 2)
    async with FakeRosbridge({}) as robot:
        health = watch(robot.url, services.url, "rosbridge")
        report = await until(
            health, lambda report: "no images of this robot" in report.video_detail
        )
        assert report.video == "down"
        robot.topics = IMAGES
        await until(health, lambda report: report.video == "ok")
        await robot.stop()
        report = await until(health, lambda report: report.video == "down")
        assert "rosbridge, the source of its video, does not answer" in report.video_detail


async def test_video_of_cameras_of_the_settings(watch, nowhere):
    with socket.create_server(("127.0.0.1", 0)) as camera:
        url = f"http://127.0.0.1:{camera.getsockname()[1]}/video"
        cameras = {"rear": f"{nowhere}/video", "front": url}
        health = watch(nowhere.replace("http", "ws"), nowhere, "auto", cameras)
        await until(health, lambda report: report.video == "ok")


async def test_rosbridge_that_its_network_reaches_is_told_until_it_is_mended(
    watch, services, monkeypatch, caplog
):
    look = Mock(return_value="0.0.0.0")
    monkeypatch.setattr(health_module, "exposed_at", look)
    monkeypatch.setattr(health_module, "SELDOM", 1)
    health = watch(services.ws_url, services.url)
    await until(health, lambda report: report.ros_exposed == "0.0.0.0")
    look.side_effect = chain([None], repeat(""))
    await until(health, lambda report: not report.ros_exposed)
    warnings = [line for line in caplog.messages if "0.0.0.0" in line]
    assert len(warnings) == 1
    assert "unless a firewall keeps them out; start it with address:=127.0.0.1" in warnings[0]


def test_exposure_is_unknown_without_a_file_descriptor():
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, hard))
    try:
        assert exposed_at("ws://127.0.0.1:9090/") is None
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


FIREWALL = Path(__file__).resolve().parents[3] / "ros" / "robotether-ros.nft"
ROSBRIDGE_PORT = 9090

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="a network namespace needs root")


@pytest.fixture
def network():
    with ExitStack() as made, namespaces.make(made, "exposure").entered():
        yield


@needs_root
@pytest.mark.usefixtures("network")
@pytest.mark.parametrize(
    ("family", "address", "expected"),
    [
        (socket.AF_INET, "0.0.0.0", "0.0.0.0"),
        (socket.AF_INET, "127.0.0.1", ""),
        (socket.AF_INET, "127.0.1.1", ""),
        (socket.AF_INET6, "::", "::"),
        (socket.AF_INET6, "::1", ""),
        (socket.AF_INET6, "::ffff:127.0.0.1", ""),
    ],
)
def test_only_an_address_beyond_loopback_is_told(family, address, expected):
    is_ipv6 = family == socket.AF_INET6
    with socket.create_server((address, 0), family=family, dualstack_ipv6=is_ipv6) as listening:
        url = f"ws://127.0.0.1:{listening.getsockname()[1]}/"
        assert exposed_at(url) == expected
    assert exposed_at(url) == ""


@needs_root
@pytest.mark.usefixtures("network")
def test_connections_are_no_listeners():
    """A robot's program that talks to its own rosbridge, or to another one at the same port, exposes nothing."""
    with (
        socket.create_server(("127.0.0.1", 0)) as listening,
        socket.create_connection(listening.getsockname()) as client,
    ):
        assert exposed_at(f"ws://127.0.0.1:{client.getsockname()[1]}") == ""


@needs_root
@pytest.mark.usefixtures("network")
def test_firewall_of_ros_1_closes_the_port_to_all_but_this_machine():
    """Rosbridge still listens on all interfaces; only what really answers counts."""
    namespaces.ip("link", "add", "robot", "type", "veth", "peer", "name", "others")
    namespaces.ip("address", "add", "192.0.2.1/24", "dev", "robot")
    namespaces.ip("link", "set", "robot", "up")
    url = f"ws://127.0.0.1:{ROSBRIDGE_PORT}/"
    with socket.create_server(("0.0.0.0", ROSBRIDGE_PORT)):
        assert exposed_at(url) == "192.0.2.1"
        # Twice, as at each start of the unit.
        for _ in range(2):
            subprocess.run(["nft", "-f", str(FIREWALL)], check=True)
        assert exposed_at(url) == ""
        socket.create_connection(("127.0.0.1", ROSBRIDGE_PORT), timeout=5).close()


@needs_root
@pytest.mark.usefixtures("network")
def test_a_port_that_answers_over_ipv6_alone_is_told():
    """A firewall may close it only over IPv4."""
    namespaces.ip("link", "add", "robot", "type", "veth", "peer", "name", "others")
    namespaces.ip("link", "set", "robot", "addrgenmode", "none")
    namespaces.ip("address", "add", "192.0.2.1/24", "dev", "robot")
    namespaces.ip("address", "add", "2001:db8::1/64", "dev", "robot", "nodad")
    namespaces.ip("link", "set", "robot", "up")
    with socket.create_server(("::", 0), family=socket.AF_INET6) as rosbridge:
        url = f"ws://127.0.0.1:{rosbridge.getsockname()[1]}/"
        assert exposed_at(url) == "2001:db8::1"


class OneAnswer(TcpService):
    def __init__(self, *lines):
        super().__init__()
        self._answer = "\r\n".join((*lines, "", "")).encode()

    async def _talk(self, reader, writer):
        await reader.readuntil(b"\r\n\r\n")
        writer.write(self._answer)
        await reader.read()


async def test_what_redirects_is_no_rosbridge(watch):
    """Following it would lead to another machine's, or end the agent at a name that none can have."""
    redirect = ("HTTP/1.1 302 Found", "Location: http://a..b/", "Content-Length: 0")
    async with OneAnswer(*redirect) as other:
        where = f"127.0.0.1:{other.port}"
        health = watch(f"ws://{where}", f"http://{where}")
        report = await until(health, lambda report: "unknown" not in (report.ros, report.video))
        assert "it answers with HTTP status 302, not with a WebSocket" in report.ros_detail
        assert await rosbridge_advice(f"ws://{where}") == ADDRESS_ADVICE


@pytest.mark.parametrize(
    ("server", "advice"),
    [("AutobahnPython/17.10.1", FIREWALL_ADVICE), ("TornadoServer/6.4", ADDRESS_ADVICE)],
)
async def test_advice_is_what_works_for_this_rosbridge(server, advice):
    switch = ("HTTP/1.1 101 Switching Protocols", f"Server: {server}", "Connection: Upgrade")
    async with OneAnswer(*switch, "Upgrade: websocket", "Sec-WebSocket-Accept: x") as rosbridge:
        assert await rosbridge_advice(f"ws://127.0.0.1:{rosbridge.port}") == advice


async def test_advice_names_both_ways_where_rosbridge_does_not_say_what_it_is():
    advice = await rosbridge_advice(f"ws://127.0.0.1:{free_port()}")
    assert ADDRESS_ADVICE in advice
    assert "ROS 1" in advice
