"""What is reported to systemd, and asked of it."""

from __future__ import annotations

import asyncio
import os
import socket

import pytest
from robotether_agent import systemd
from robotether_agent.problems import UpgradeFailedError
from robotether_agent.systemd import Notifier


def test_without_systemd_there_is_no_state(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert systemd.state() is None
    with pytest.raises(UpgradeFailedError, match="cannot run systemctl"):
        systemd.reload_units()


def test_speaks_to_an_abstract_socket():
    name = f"robotether-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(f"\0{name}")
        listening.settimeout(5)
        Notifier(f"@{name}").ready()
        assert listening.recv(100) == b"READY=1"


async def test_without_systemd_nothing_happens():
    Notifier.from_environ({}).ready()
    Notifier("/nowhere/notify").ready()
    environ = {"WATCHDOG_USEC": "1000", "WATCHDOG_PID": str(os.getpid() + 1)}
    task = asyncio.ensure_future(Notifier.from_environ(environ).keep_watchdog())
    await asyncio.sleep(0)
    assert not task.done()
    task.cancel()
    await asyncio.wait({task})
