"""The probes of rosbridge and web_video_server against real servers, and the warning when its network reaches one."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable

import pytest
from fake_cameras import TopicRosbridge
from fake_cloud import eventually
from local_network import free_port
from robotether_agent import health as health_module
from robotether_agent.health import Health, HealthReport
from robotether_agent.video import sources as sources_module
from robotether_agent.video.sources import SourceSettings

EVERY_S = 0.1


@pytest.fixture
def watch(make_graph, spawn) -> Callable[..., Health]:
    def start(rosbridge_url: str, video_url: str, *more: object) -> Health:
        settings = SourceSettings(video_url, rosbridge_url, *more)
        health = Health(settings, make_graph(rosbridge_url), every_s=EVERY_S)
        spawn(health.run())
        return health

    return start


async def until(health: Health, reached: Callable[[HealthReport], bool]) -> HealthReport:
    async def follow() -> HealthReport:
        report = health.report
        while not reached(report):
            report = await health.changed(report)
        return report

    return await asyncio.wait_for(follow(), 10)


async def test_both_ok_over_one_held_handshake(watch, services, monkeypatch, caplog):
    """No look takes a handshake of its own; one that a busy machine lost is said to be lost."""
    monkeypatch.setattr("robotether_agent.rosbridge.ANSWER_WITHIN_S", 0.1)
    health = watch(services.ws_url, services.http_url)
    report = await until(health, lambda report: report.ros == report.video == "ok")
    assert report.detail == ""
    services.video_status = 500
    await until(health, lambda report: report.video == "down")
    services.video_status = 200
    await until(health, lambda report: report.video == "ok")

    def held() -> int:
        return services.handshakes - caplog.text.count("[rosbridge_down]")

    await eventually(lambda: held() == 2, lambda: f"{held()} clients beside those that were lost")


IMAGES = {"/camera/image_raw/compressed": "sensor_msgs/msg/CompressedImage"}


@pytest.fixture
def nowhere() -> str:
    return f"http://127.0.0.1:{free_port()}"


RAW = {"/camera/image_raw": "sensor_msgs/Image"}


@pytest.mark.parametrize(("topics", "has_pyav"), [(IMAGES, False), (RAW, True)])
async def test_video_comes_from_rosbridge_while_no_server_answers(
    watch, nowhere, monkeypatch, topics, has_pyav
):
    monkeypatch.setattr(health_module, "SELDOM", 2)
    monkeypatch.setattr(sources_module, "has_pyav", lambda: has_pyav)
    async with TopicRosbridge({} if has_pyav else RAW) as robot:
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
    async with TopicRosbridge({}) as robot:
        health = watch(robot.url, services.http_url, "rosbridge")
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
    address = ["0.0.0.0"]
    monkeypatch.setattr(health_module, "exposed_at", lambda _url: address[0])
    monkeypatch.setattr(health_module, "SELDOM", 1)
    health = watch(services.ws_url, services.http_url)
    await until(health, lambda report: report.ros_exposed == "0.0.0.0")
    address[0] = ""
    await until(health, lambda report: not report.ros_exposed)
    warnings = [line for line in caplog.messages if "0.0.0.0" in line]
    assert len(warnings) == 1
    assert "past the guard; start it with address:=127.0.0.1" in warnings[0]
