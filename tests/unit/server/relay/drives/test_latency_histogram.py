"""Quantiles of round trips."""

from __future__ import annotations

import math
import random

import pytest
from robotether_server.relay.drives.latency_histogram import MAX_MS, MIN_MS, STEP, LatencyHistogram


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
    assert len(latency._counts) <= math.log(MAX_MS / MIN_MS) / STEP + 2
    assert latency.quantile(0.01) == pytest.approx(MIN_MS, rel=0.01)
    assert latency.quantile(0.99) == pytest.approx(MAX_MS, rel=0.01)
