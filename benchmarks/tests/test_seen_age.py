"""What the seen_age part makes of what it has measured."""

from __future__ import annotations

import pytest
from seen_age import Seen, row


def test_an_age_that_is_too_young_is_counted_however_seldom_it_is() -> None:
    """What rounds away is not; the way to the guard makes an age a little older."""
    seen = [Seen(100.0, 122.0)] * 97 + [Seen(100.0, 118.9), Seen(100.0, 118.0), Seen(40.0, 70.0)]
    made = row("38 ms", seen, 19.0)
    assert (made["commands"], made["too young"], made["over the aim"]) == (100, 1, 1)
    assert made["age when sent, p50, ms"] == 100
    assert made["error, p0, ms"] == pytest.approx(-1)
    assert made["error, p50, ms"] == pytest.approx(3)
