"""What systemctl says, with doubles of it on the path."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from robotether_agent import systemd
from robotether_agent.problems import UpgradeFailed


@pytest.fixture
def systemctl(tmp_path, monkeypatch) -> Callable[[str], Path]:
    """Puts a script in the place of systemctl, and returns where it notes its words."""
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")

    def make(script: str) -> Path:
        double = tmp_path / "systemctl"
        double.write_text(f'#!/bin/sh\necho "$@" >> {tmp_path}/words\n{script}\n')
        double.chmod(0o755)
        return tmp_path / "words"

    return make


def test_tells_the_services_state(systemctl):
    """Systemd's own word is passed on, also with its exit code for a service that does not run."""
    words = systemctl("echo failed; exit 3")
    assert systemd.state() == "failed"
    assert words.read_text() == "is-active robotether-agent.service\n"


def test_without_systemd_there_is_no_state(tmp_path, monkeypatch):
    """A container has none, and a robot on which it does not run answers nothing."""
    monkeypatch.setenv("PATH", str(tmp_path))
    assert systemd.state() is None
    with pytest.raises(UpgradeFailed, match="cannot run systemctl"):
        systemd.reload_units()


def test_restarts_and_tells_why_not(systemctl):
    """What systemctl says stands in the problem."""
    words = systemctl("exit 0")
    systemd.reload_units()
    systemd.restart()
    assert words.read_text() == "daemon-reload\nrestart robotether-agent.service\n"
    systemctl("echo Unit not found >&2; exit 5")
    with pytest.raises(UpgradeFailed, match="Unit not found") as error:
        systemd.restart()
    assert "journalctl" in error.value.advice
