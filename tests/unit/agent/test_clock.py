"""The clocks that a robot's session reports."""

from __future__ import annotations

import time

from robotether_agent import clock
from robotether_agent.clock import EpochClock


def test_a_later_session_has_a_greater_number(monkeypatch):
    now = [time.time_ns()]
    monkeypatch.setattr(clock.time, "time_ns", lambda: now[0])
    epochs = EpochClock()
    first = epochs.next()
    assert first == now[0] // 1_000_000
    now[0] -= 10**12
    assert [epochs.next(), epochs.next()] == [first + 1, first + 2]
    now[0] += 2 * 10**12
    assert epochs.next() == now[0] // 1_000_000 < 2**53
