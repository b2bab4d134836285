"""The boot service's own command, for what shows only in its exit code and its log."""

from __future__ import annotations

import logging
import os
import signal
import socket
import threading
import time
from contextlib import suppress

import pytest
from robotether_agent.cli import run as command
from robotether_agent.problems import AlreadyRunning, HostKeyChanged
from robotether_agent.settings import Settings


@pytest.fixture
def environ(place):
    """The environment of a service, with the socket as `systemd` listens on it."""
    return {"NOTIFY_SOCKET": str(place / "notify"), "WATCHDOG_USEC": "400000"}


@pytest.fixture
def systemd(place):
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(place / "notify"))
        listening.setblocking(False)
        yield listening
    for number, handler in before.items():
        signal.signal(number, handler)


def failing(error: Exception) -> type:
    """An agent that ends with this."""

    class Failing:
        def __init__(self, *_: object) -> None:
            raise error

    return Failing


def said(systemd: socket.socket) -> list[str]:
    found = []
    with suppress(BlockingIOError):
        while True:
            found.append(systemd.recv(1000).decode())
    return found


def test_failed_start_pauses_before_systemd_starts_the_agent_again(
    monkeypatch, place, environ, systemd
):
    """The pause is no hanging loop: the watchdog gets its signs of life."""
    monkeypatch.setattr(command, "Agent", failing(ZeroDivisionError("a defect")))
    monkeypatch.setattr(command, "before_restart", lambda *_: 0.5)
    began = time.monotonic()
    assert command.run(Settings(server="a.example", run_dir=place), environ) == 1
    assert time.monotonic() - began >= 0.5
    told = said(systemd)
    assert told[0] == "STATUS=failed; starts again in 0 s"
    assert told[-1] == "STOPPING=1"
    assert told.count("WATCHDOG=1") >= 2


def test_pause_ends_when_the_service_is_stopped(monkeypatch, place, environ, systemd):
    monkeypatch.setattr(command, "Agent", failing(AlreadyRunning("cannot start")))
    monkeypatch.setattr(command, "before_restart", lambda *_: 60.0)
    stop = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGTERM))
    stop.start()
    began = time.monotonic()
    assert command.run(Settings(server="a.example", run_dir=place), environ) == 0
    assert time.monotonic() - began < 30
    stop.join()


def test_no_pause_where_nobody_starts_it_again(monkeypatch, place, environ, systemd):
    """Neither for a person at a terminal, nor where the unit says that a person must look first."""
    monkeypatch.setattr(command, "before_restart", lambda *_: pytest.fail("it pauses"))
    settings = Settings(server="a.example", run_dir=place)
    monkeypatch.setattr(command, "Agent", failing(AlreadyRunning("cannot start")))
    assert command.run(settings, {}) == AlreadyRunning.exit_code
    monkeypatch.setattr(command, "Agent", failing(HostKeyChanged("another key")))
    assert command.run(settings, environ) == HostKeyChanged.exit_code


def test_an_error_of_the_agent_itself_leaves_its_traceback(monkeypatch, place, capsys):
    """Systemd starts it again, and the journal has what a developer needs."""
    monkeypatch.setattr(command, "Agent", failing(ZeroDivisionError("a defect")))
    assert command.run(Settings(server="a.example", run_dir=place), {}) == 1
    told = capsys.readouterr().err
    assert "stopped by an error in the agent itself" in told
    assert "ZeroDivisionError: a defect" in told


def test_a_problem_that_ends_it_has_its_exit_code(monkeypatch, place, capsys):
    """A person reads one sentence, and no traceback."""
    monkeypatch.setattr(
        command, "Agent", failing(AlreadyRunning("cannot start: another agent runs"))
    )
    code = command.run(Settings(server="a.example", run_dir=place), {"JOURNAL_STREAM": "1:2"})
    assert code == AlreadyRunning.exit_code
    assert capsys.readouterr().err.splitlines() == [
        "<2>STOPPED: cannot start: another agent runs [already_running]"
    ]


def teardown_module() -> None:
    """The handler writes to what pytest captured."""
    logging.getLogger().handlers.clear()
