"""What the fan_out part makes of what it has measured."""

from __future__ import annotations

import pytest
from fan_out import FAST, Run, rows


def test_each_run_is_compared_with_the_first_of_its_topics() -> None:
    """The processor is that of the messages beyond the first run's, whatever an idle relay uses."""
    runs = [
        Run("/scan", 1, 10.0, 50, 100_000, 0.1),
        Run("/scan", 20, 10.0, 1000, 104_000, 0.2),
        Run(FAST, 1, 10.0, 10_000, 500_000, 3.0),
        # It lasted longer, and its observers got less than all.
        Run(FAST, 5, 20.0, 80_000, 500_000, 12.0),
    ]
    first, shared, fast, further = rows(runs)
    assert first["uplink, times one"] == fast["uplink, times one"] == 1
    assert shared["uplink, times one"] == pytest.approx(1.04)
    assert (first["messages/s each"], further["messages/s each"]) == (5, 800)
    assert further["relay, % of a core"] == pytest.approx(60)
    column = "relay, % of a core for each further 1000 messages/s"
    assert fast[column] is None
    assert further[column] == pytest.approx(10)
