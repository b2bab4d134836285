"""A run notes what a real simulated robot shows and gets, straight and without any network."""

from __future__ import annotations

import os
from collections.abc import AsyncIterator

import aiohttp
import pytest
from paper.operators_run import OperatorClient, Times, camera_fps, measured
from sim_client import SETTINGS
from sim_robot import camera
from sim_robot.kinematics import Pose, Velocity
from sim_robot.simulator import Simulator
from video_viewers import Frame, OnFrame, view_stream

SHORT = Times(settle_s=0.2, measure_s=1.0)


@pytest.fixture
async def client() -> AsyncIterator[OperatorClient]:
    """An operator who is at the robot itself."""
    async with Simulator(SETTINGS) as simulator, aiohttp.ClientSession() as http:
        ros = f"ws://127.0.0.1:{simulator.rosbridge.port}/"
        video = f"http://127.0.0.1:{simulator.video.port}/stream?topic=/camera/image_raw"

        async def view(on_frame: OnFrame) -> None:
            await view_stream(http, video, on_frame)

        async with http.ws_connect(ros) as operator, http.ws_connect(ros) as subscriber:
            yield OperatorClient(
                robot="sim",
                view=view,
                rosbridge=operator,
                subscriber=subscriber,
                local_view=view,
                simulator_pid=os.getpid(),
                agent_pid=os.getpid(),
            )


async def test_pictures_and_commands_of_the_measured_time_are_noted(client: OperatorClient) -> None:
    """Twenty commands in a second, all of which come, and pictures with an age."""
    run = await measured([client], SHORT)
    [robot] = run.robots
    assert 19 <= len(robot.commands_ms) <= 21 + 20 * (run.lasted_s - 1)
    assert None not in robot.commands_ms
    assert len(robot.pictures) >= 5
    assert all(age > 0 and size > 1000 for _, size, age in robot.pictures)
    assert all(0 <= at <= run.lasted_s * 1000 for at, *_ in robot.pictures)
    assert robot.camera_fps is not None
    assert robot.width_px == 640
    assert robot.simulator_cpu > 0
    assert 0 < run.busy <= 1


def frame(at_s: float, number: int | None) -> Frame:
    """One that shows the moment `at_s`, and comes 0.5 s later."""
    scene = camera.Scene("sim", 20, Pose(1, 1, 0), Velocity(0, 0, 0), (), 0.0, int(at_s * 1e9))
    jpeg = camera.jpeg(camera.draw(scene, (640, 480)), 80)
    return Frame(at_s + 0.5, jpeg, number)


def test_the_cameras_rate_is_that_of_all_its_pictures() -> None:
    """Two that came of eleven in a second, also over the end of the numbers."""
    assert camera_fps([frame(100, 5), frame(101, 15)], [], 100, 102) == pytest.approx(10)
    last = (1 << 32) - 4
    assert camera_fps([frame(100, last), frame(101, 6)], [], 100, 102) == pytest.approx(10)


def test_without_numbers_the_onlooker_tells_the_cameras_rate() -> None:
    """By those of the time that is measured; without both nothing does."""
    moments = [99.0, *(100 + number / 10 for number in range(20)), 103.0]
    assert camera_fps([frame(100, None)], moments, 100, 102) == pytest.approx(10)
    assert camera_fps([], [], 100, 102) is None
