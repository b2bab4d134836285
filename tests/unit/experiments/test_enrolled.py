"""Enrolled robots: their MACs, and what an agent is told."""

from __future__ import annotations

from pathlib import Path

import pytest
from paper.enrolled import Enrolled, environment, local_mac
from robotether_agent import settings as agent_settings
from robotether_agent.setting_values import normalise_mac

ROBOT = Enrolled("x-1", 1, local_mac(1, 1), "192.0.2.1:443", "ab" * 32, Path("/tmp/x-1"))


@pytest.mark.parametrize(("pid", "number"), [(1, 1), (4_194_303, 65_535)])
def test_a_mac_is_one_that_a_machine_gives_itself(pid: int, number: int) -> None:
    """So it is no real robot's; it has its usual spelling."""
    mac = local_mac(pid, number)
    assert normalise_mac(mac, allow_local=True) == mac
    assert int(mac[:2], 16) & 3 == 2


def test_macs_differ_by_process_and_number() -> None:
    """No two robots of two processes have one."""
    made = [local_mac(pid, number) for pid in (77, 78) for number in (1, 256, 257)]
    assert len(set(made)) == 6


def test_the_agent_takes_the_settings() -> None:
    """With more of the robot's own."""
    given = agent_settings.load(None, environment({**ROBOT.settings, "guard": "off"}))
    assert (given.server, given.mac, given.guard) == (ROBOT.server, ROBOT.mac, "off")
    assert given.state_dir == ROBOT.state_dir
