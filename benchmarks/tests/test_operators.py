"""A run notes what a real simulated robot shows and gets; its figures are pooled over robots."""

from __future__ import annotations

import json
import os
from collections.abc import AsyncIterator
from typing import Any

import aiohttp
import pytest
from paper.operators.report import longest_pause_ms, summary
from paper.operators.run import OperatorClient, Run, Seen, Times, camera_fps, measured
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
    assert camera_fps([frame(100, 5), frame(101, 15)], [], 100, 102) == pytest.approx(10)
    last = (1 << 32) - 4
    assert camera_fps([frame(100, last), frame(101, 6)], [], 100, 102) == pytest.approx(10)


def test_without_numbers_the_onlooker_tells_the_cameras_rate() -> None:
    moments = [99.0, *(100 + number / 10 for number in range(20)), 103.0]
    assert camera_fps([frame(100, None)], moments, 100, 102) == pytest.approx(10)
    assert camera_fps([], [], 100, 102) is None


"""Figures of the operators' experiment: pooled over robots, and nothing made up where nothing came."""


def seen(**changed: Any) -> Seen:
    """A robot with a picture of 20 KB each 100 ms and two commands."""
    values: dict[str, Any] = {
        "pictures": [(100.0 * number, 20_000, 50.0 + number) for number in range(10)],
        "camera_fps": 10.0,
        "quality": 80.0,
        "width_px": 640.0,
        "commands_ms": [20.0, 30.0],
        "driven_ms": [0.0, 50.0, 700.0],
        "refused": 0,
        "simulator_cpu": 0.1,
        "agent_cpu": 0.2,
    }
    return Seen(**{**values, **changed})


def test_rates_are_those_of_one_robot() -> None:
    one, two = summary([seen()], 1.0), summary([seen(), seen()], 1.0)
    assert one.pictures_per_s == two.pictures_per_s == 10
    assert one.mbit_s == two.mbit_s == pytest.approx(1.6)
    assert one.picture_kb == 20


def test_delays_are_within_one_robots_pictures() -> None:
    both = summary([seen(), seen(pictures=[(0.0, 1, 5.0), (300.0, 1, 5.0)])], 1.0)
    assert both.delay_mean_ms == pytest.approx((9 * 100 + 300) / 10)
    assert both.delay_p95_ms == pytest.approx(100 + 200 * 0.55)


def test_percentiles_are_of_all_samples() -> None:
    both = summary([seen(commands_ms=[10.0] * 3), seen(commands_ms=[90.0])], 1.0)
    assert both.command_p50_ms == 10
    assert both.command_p99_ms == pytest.approx(10 + 80 * 0.97)


def test_lost_commands_are_counted_and_in_no_percentile() -> None:
    one = summary([seen(commands_ms=[10.0, None, 12.0])], 1.0)
    assert (one.commands, one.lost, one.command_p50_ms) == (3, 1, 11)


def test_what_did_not_come_has_no_figure() -> None:
    one = summary(
        [seen(pictures=[], commands_ms=[None], driven_ms=[], quality=None, camera_fps=None)], 2.0
    )
    assert (one.pictures_per_s, one.mbit_s, one.lost) == (0, 0, 1)
    assert one.age_p95_ms is one.delay_mean_ms is one.command_p99_ms is one.quality is None
    assert one.longest_pause_ms == 2000


def test_a_pause_at_either_end_counts() -> None:
    assert longest_pause_ms([400.0, 450.0], 1.0) == 550
    assert longest_pause_ms([900.0, 950.0], 1.0) == 900


def test_a_run_comes_back_from_the_results_as_it_was() -> None:
    run = Run(lasted_s=1.0, busy=0.5, robots=[seen(), seen(quality=None)])
    kept = Run.of(json.loads(json.dumps(run.as_values())))
    assert summary(kept.robots, 1.0) == summary(run.robots, 1.0)
