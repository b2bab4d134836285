"""sd_notify over a real Unix socket."""

from __future__ import annotations

import asyncio
import os
import socket

import pytest
from robotether_agent.notify import Notifier


@pytest.fixture
def systemd(place):
    """A socket as systemd listens on."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(place / "notify"))
        listening.settimeout(5)
        yield listening


def test_says_ready_status_and_stopping(systemd, place):
    """Each message is the line that systemd documents."""
    notifier = Notifier.from_environ({"NOTIFY_SOCKET": str(place / "notify")})
    notifier.ready()
    notifier.status("connected to a.example as sim1")
    notifier.stopping()
    said = [systemd.recv(1000).decode() for _ in range(3)]
    assert said == ["READY=1", "STATUS=connected to a.example as sim1", "STOPPING=1"]


def test_speaks_to_an_abstract_socket():
    name = f"robotether-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(f"\0{name}")
        listening.settimeout(5)
        Notifier(f"@{name}").ready()
        assert listening.recv(100) == b"READY=1"


async def test_watchdog_at_half_its_time(systemd, place):
    """With a watchdog of 0.2 s a sign of life comes about every 0.1 s."""
    environ = {"NOTIFY_SOCKET": str(place / "notify"), "WATCHDOG_USEC": "200000"}
    loop = asyncio.get_running_loop()
    task = asyncio.ensure_future(Notifier.from_environ(environ).keep_watchdog())
    times = []
    for _ in range(3):
        assert await asyncio.to_thread(systemd.recv, 100) == b"WATCHDOG=1"
        times.append(loop.time())
    task.cancel()
    await asyncio.wait({task})
    assert 0.15 < times[2] - times[0] < 2


async def test_without_systemd_nothing_happens():
    """Without a socket, or with one that is gone, the agent goes on; a watchdog of another process is not ours."""
    Notifier.from_environ({}).ready()
    Notifier("/nowhere/notify").ready()
    environ = {"WATCHDOG_USEC": "1000", "WATCHDOG_PID": str(os.getpid() + 1)}
    task = asyncio.ensure_future(Notifier.from_environ(environ).keep_watchdog())
    await asyncio.sleep(0)
    assert not task.done()
    task.cancel()
    await asyncio.wait({task})
