"""A run notes what a real simulated robot shows and gets; its figures are pooled over robots."""

from __future__ import annotations

import math
from typing import Any

import pytest
from paper.operators.report import figures, longest_pause_ms
from paper.operators.run import camera_fps
from sim_robot import camera
from sim_robot.kinematics import Pose, Velocity
from video_viewers import Frame


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


def seen(**changed: Any) -> dict[str, Any]:
    """A robot with a frame of 20 KB each 100 ms and two commands."""
    values: dict[str, Any] = {
        "pictures": [(100.0 * number, 20_000, 50.0 + number) for number in range(10)],
        "camera_fps": 10.0,
        "quality": 80.0,
        "width_px": 640.0,
        "commands_ms": [20.0, 30.0],
        "driven_ms": [0.0, 50.0, 700.0],
        "refused": 0,
        "simulator_cpu": 0.1,
    }
    return {**values, **changed}


def summary(*robots: dict[str, Any], lasted_s: float = 1.0) -> dict[str, Any]:
    return figures({"robots": robots, "lasted_s": lasted_s, "busy": 0.5})


def test_rates_are_those_of_one_robot() -> None:
    one, two = summary(seen()), summary(seen(), seen())
    assert one["frames/s"] == two["frames/s"] == 10
    assert one["Mbit/s a robot"] == two["Mbit/s a robot"] == pytest.approx(1.6)
    assert one["KB a frame"] == 20


def test_delays_are_within_one_robots_frames() -> None:
    both = summary(seen(), seen(pictures=[(0.0, 1, 5.0), (300.0, 1, 5.0)]))
    assert both["delay mean, ms"] == pytest.approx((9 * 100 + 300) / 10)
    assert both["delay p95, ms"] == pytest.approx(100 + 200 * 0.55)


def test_percentiles_are_of_all_samples() -> None:
    both = summary(seen(commands_ms=[10.0] * 3), seen(commands_ms=[90.0]))
    assert both["command p50, ms"] == 10
    assert both["command p99, ms"] == pytest.approx(10 + 80 * 0.97)


def test_lost_commands_are_counted_and_in_no_percentile() -> None:
    one = summary(seen(commands_ms=[10.0, None, 12.0]))
    assert (one["lost"], one["command p50, ms"]) == ("1 of 3", 11)


def test_what_did_not_come_has_no_figure() -> None:
    nothing = seen(pictures=[], commands_ms=[None], driven_ms=[], quality=None, camera_fps=None)
    one = summary(nothing, lasted_s=2.0)
    assert (one["frames/s"], one["Mbit/s a robot"], one["lost"]) == (0, 0, "1 of 1")
    missing = ("age p95, ms", "delay mean, ms", "command p99, ms", "asked quality")
    assert all(math.isnan(one[name]) for name in missing)
    assert one["longest pause, ms"] == 2000


def test_a_pause_at_either_end_counts() -> None:
    assert longest_pause_ms([400.0, 450.0], 1.0) == 550
    assert longest_pause_ms([900.0, 950.0], 1.0) == 900
