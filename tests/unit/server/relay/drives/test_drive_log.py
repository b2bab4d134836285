"""The books of a drive."""

from __future__ import annotations

import math
import random
from collections import Counter

import pytest
from relay_server import utc
from robotether_server.db.control import DriveEntry
from robotether_server.relay.drives.drive_log import (
    LATENCY_STEP,
    MAX_LATENCY_MS,
    MIN_LATENCY_MS,
    DriveCounters,
    DriveLog,
    LatencyHistogram,
)
from robotether_server.relay.drives.viewer_stats import ViewerCounts

NOON = utc(2026, 1, 1, 12, 0)


@pytest.fixture
def refused() -> Counter[str]:
    return Counter()


@pytest.fixture
def log(refused) -> DriveLog:
    return DriveLog(DriveEntry(7, "sim1", "ann", 1, NOON), 0.5, refused)


def test_distance_is_speed_times_the_time_to_the_next_command(log):
    """A spiral of two commands; the top speeds stay."""
    log.command(10.0, 1.0, 0.5)
    log.command(10.2, 2.0, 0.1)
    entry = log.end(10.3, NOON, "client_left")
    assert entry.distance_m == pytest.approx(0.2 + 0.2)
    assert entry.turned_rad == pytest.approx(0.1 + 0.01)
    assert (entry.top_speed_m_s, entry.top_turn_rad_s) == (2.0, 0.5)


def test_a_command_counts_no_longer_than_the_guard_lets_it(log):
    """After the deadman the robot stands, however long the silence."""
    log.command(10.0, 1.0, None)
    log.command(100.0, 0.0, None)
    assert log.end(200.0, NOON, "client_left").distance_m == pytest.approx(0.5)


def test_a_drive_without_commands_goes_nowhere(log):
    """Nothing is counted from before the first command."""
    assert log.end(1e6, NOON, "client_left").distance_m == 0


def test_refusals_messages_and_stops_are_in_the_entry(log, refused):
    """What was counted elsewhere meanwhile is written, too."""
    refused["topic"] += 2
    log.message()
    log.dropped()
    assert log.written().refused == {"topic": 2}
    entry = log.end(1.0, NOON, "robot_stopped")
    assert (entry.messages, entry.dropped_old, entry.stops) == (1, 1, 1)
    assert (entry.ended_at, entry.end_code) == (NOON, "robot_stopped")


def test_what_the_guard_refused_stands_apart_from_the_policys(log, refused):
    """Also what it tells after the end."""
    refused["shape"] += 1
    log.refused_by_guard({"shape": 2})
    assert log.written().refused == {"shape": 1, "guard_shape": 2}
    log.end(1.0, NOON, "client_left")
    log.refused_by_guard({"shape": 1, "old": 1})
    assert log.written().refused == {"shape": 1, "guard_shape": 3, "guard_old": 1}


class Counts:
    """What others count, set by hand."""

    def __init__(self) -> None:
        self.bytes = 0
        self.rtt_ms: float | None = None
        self.viewer_counts = ViewerCounts(100, 5000, 60.0)

    def counters(self) -> DriveCounters:
        return DriveCounters(lambda: self.bytes, lambda: self.rtt_ms, lambda: self.viewer_counts)


def test_bytes_and_frames_are_those_of_the_drive(refused):
    """Not what the driver saw before it, nor what comes after its end."""
    counts = Counts()
    log = DriveLog(DriveEntry(7, "sim1", "ann", 1, NOON), 0.5, refused, counts.counters())
    counts.bytes, counts.viewer_counts = 700, ViewerCounts(130, 8000, 62.5)
    entry = log.written()
    assert (entry.bytes, entry.pictures, entry.picture_bytes, entry.viewed_s) == (
        700,
        30,
        3000,
        2.5,
    )
    counts.bytes = 800
    log.end(1.0, NOON, "client_left")
    counts.bytes, counts.viewer_counts = 900, ViewerCounts(999, 99_999, 999.0)
    log.refused_by_guard({"old": 1})
    entry = log.written()
    assert (entry.bytes, entry.pictures, entry.refused) == (800, 30, {"guard_old": 1})


def test_latency_is_the_way_from_the_driver_to_the_robot(refused):
    """Both halves as they are at that moment; without the robot's half nothing is claimed."""
    counts = Counts()
    log = DriveLog(DriveEntry(7, "sim1", "ann", 1, NOON), 0.5, refused, counts.counters())
    log.round_trip(10.0)
    assert log.written().latency_p50_ms is None
    counts.rtt_ms = 20.0
    for _ in range(94):
        log.round_trip(10.0)
    for _ in range(6):
        log.round_trip(180.0)
    entry = log.end(1.0, NOON, "client_left")
    assert entry.latency_p50_ms == pytest.approx(30, rel=0.01)
    assert entry.latency_p95_ms == pytest.approx(200, rel=0.01)


def of(*values: float) -> LatencyHistogram:
    latency = LatencyHistogram()
    for value in values:
        latency.add(value)
    return latency


def test_without_a_round_trip_nothing_is_claimed():
    """No number is better than a wrong one."""
    assert LatencyHistogram().quantile(0.5) is None


@pytest.mark.parametrize("share", [0.5, 0.95, 0.99])
def test_quantiles_are_those_of_what_was_measured(share):
    """Within 1 %, over links of every kind; the share of all values is at most the quantile."""
    dice = random.Random(5)
    values = sorted(dice.lognormvariate(4, 1) for _ in range(2000))
    expected = values[round(share * len(values)) - 1]
    assert of(*values).quantile(share) == pytest.approx(expected, rel=0.012)


def test_memory_is_bounded_whatever_comes():
    """Clocks that jump make the least or the most of all times."""
    latency = of(*(10.0**power for power in range(-300, 300)), 0.0, -5.0, float("inf"))
    assert len(latency._counts) <= math.log(MAX_LATENCY_MS / MIN_LATENCY_MS) / LATENCY_STEP + 2
    assert latency.quantile(0.01) == pytest.approx(MIN_LATENCY_MS, rel=0.01)
    assert latency.quantile(0.99) == pytest.approx(MAX_LATENCY_MS, rel=0.01)
