"""The robot's clock."""

from __future__ import annotations

import time

import pytest
from robotether_agent import clock
from robotether_agent.clock import robot_time


def test_it_goes_on_while_the_robot_sleeps(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = {time.CLOCK_MONOTONIC: 5.0, time.CLOCK_BOOTTIME: 65.0}
    monkeypatch.setattr(clock.time, "clock_gettime", shown.get)
    assert robot_time() == 65.0
