"""Figures of the operators' experiment: pooled over robots, and nothing made up where nothing came."""

from __future__ import annotations

import json
from typing import Any

import pytest
from paper.operators_values import Run, Seen, longest_pause_ms, summary


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
    """Two robots' pictures in a second are as many a second as one's."""
    one, two = summary([seen()], 1.0), summary([seen(), seen()], 1.0)
    assert one.pictures_per_s == two.pictures_per_s == 10
    assert one.mbit_s == two.mbit_s == pytest.approx(1.6)
    assert one.picture_kb == 20


def test_delays_are_within_one_robots_pictures() -> None:
    """From one to the next of the same camera."""
    both = summary([seen(), seen(pictures=[(0.0, 1, 5.0), (300.0, 1, 5.0)])], 1.0)
    assert both.delay_mean_ms == pytest.approx((9 * 100 + 300) / 10)
    assert both.delay_p95_ms == pytest.approx(100 + 200 * 0.55)


def test_percentiles_are_of_all_samples() -> None:
    """And not means of the robots' own."""
    both = summary([seen(commands_ms=[10.0] * 3), seen(commands_ms=[90.0])], 1.0)
    assert both.command_p50_ms == 10
    assert both.command_p99_ms == pytest.approx(10 + 80 * 0.97)


def test_lost_commands_are_counted_and_in_no_percentile() -> None:
    """One of three never came."""
    one = summary([seen(commands_ms=[10.0, None, 12.0])], 1.0)
    assert (one.commands, one.lost, one.command_p50_ms) == (3, 1, 11)


def test_what_did_not_come_has_no_figure() -> None:
    """A robot without a picture and a command has rates of zero, and no delay, age or latency."""
    one = summary(
        [seen(pictures=[], commands_ms=[None], driven_ms=[], quality=None, camera_fps=None)], 2.0
    )
    assert (one.pictures_per_s, one.mbit_s, one.lost) == (0, 0, 1)
    assert one.age_p95_ms is one.delay_mean_ms is one.command_p99_ms is one.quality is None
    assert one.longest_pause_ms == 2000


def test_a_pause_at_either_end_counts() -> None:
    """Silence before the first and after the last command is silence."""
    assert longest_pause_ms([400.0, 450.0], 1.0) == 550
    assert longest_pause_ms([900.0, 950.0], 1.0) == 900


def test_a_run_comes_back_from_the_results_as_it_was() -> None:
    """Through JSON, which knows no tuples."""
    run = Run(lasted_s=1.0, busy=0.5, robots=[seen(), seen(quality=None)])
    assert Run.of(json.loads(json.dumps(run.as_values()))).summary == run.summary
