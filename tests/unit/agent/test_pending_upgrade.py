"""The unit that finishes a change of version at the next boot."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from robotether_agent.pending_upgrade import BOOT, NAME, PendingUpgrade
from robotether_agent.problems import StateUnusable

WAS, TARGET = Path("/opt/a/versions/1"), Path("/opt/a/versions/2")


def test_the_next_boot_starts_the_old_version(tmp_path):
    """A later change takes the place of the one before; the new version is only named."""
    unfinished = PendingUpgrade(tmp_path)
    unfinished.note(WAS, WAS, "pending", 1)
    unfinished.note(WAS, TARGET, "connected", 60)
    lines = (tmp_path / BOOT / NAME).read_text().splitlines()
    command = "/opt/a/versions/1/bin/robotether-agent finish-switch"
    start = f"ExecStart={command} --wait 60 {WAS} {TARGET} connected"
    assert [line for line in lines if line.startswith("ExecStart")] == [start]


def test_nothing_is_left_once_it_is_finished(tmp_path):
    """Neither the unit nor its link, also when there was none."""
    unfinished = PendingUpgrade(tmp_path)
    unfinished.clear()
    unfinished.note(WAS, TARGET, "connected", 60)
    unfinished.clear()
    assert list(tmp_path.rglob("*.service")) == []


def test_a_place_that_cannot_be_written_is_told(tmp_path):
    """What could not be removed would change versions at the next boot."""
    (tmp_path / BOOT / NAME).mkdir(parents=True)
    with pytest.raises(StateUnusable, match="cannot make"):
        PendingUpgrade(tmp_path).note(WAS, TARGET, "connected", 60)
    with pytest.raises(StateUnusable, match="cannot remove"):
        PendingUpgrade(tmp_path).clear()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd")
def test_systemd_reads_it(tmp_path):
    """Not one of its lines is unknown to this machine's systemd."""
    PendingUpgrade(tmp_path).note(Path("/usr"), TARGET, "connected", 60)
    unit = tmp_path / NAME
    unit.write_text(unit.read_text().replace("/usr/bin/robotether-agent", "/bin/true"))
    command = ["systemd-analyze", "verify", "--man=no", str(unit)]
    told = subprocess.run(command, check=False, capture_output=True, text=True).stderr
    assert NAME not in told


@pytest.mark.parametrize("state", ["hacked", "", "connected\nExecStartPre=/bin/sh -c id", "a b"])
def test_only_states_that_are_known_reach_the_unit(tmp_path, state):
    """The agent's user writes its state, and root runs the unit."""
    PendingUpgrade(tmp_path).note(WAS, TARGET, state, 60)
    lines = (tmp_path / NAME).read_text().splitlines()
    starts = [line for line in lines if line.startswith("Exec")]
    assert len(starts) == 1
    assert starts[0].endswith(f" {TARGET} silent")
