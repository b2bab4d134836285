"""`robotether-agent run`: a process that systemd and people start, watch and end."""

import asyncio
import logging
import os
import signal
import socket
import sys
import threading
import time
from asyncio.subprocess import PIPE
from contextlib import suppress

import pytest
from fake_cloud import WAIT_S, agent_environ, eventually
from openssh_server import descendants, is_alive
from robotether_agent import cli as command
from robotether_agent import systemd
from robotether_agent.problems import AlreadyRunningError, ServerKeyChangedError, UpgradeFailedError
from robotether_agent.settings import Settings
from robotether_agent.status import read_status


@pytest.fixture
async def start(place):
    started = []

    async def run(cloud, command):
        variables = {"PATH": os.environ["PATH"], "PYTHONPATH": ":".join(sys.path)}
        # So that what it runs counts as covered.
        variables |= {key: os.environ[key] for key in os.environ if key.startswith("COVERAGE_")}
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "robotether_agent",
            command,
            env={**variables, **agent_environ(cloud, place)},
            stdout=PIPE,
            stderr=PIPE,
        )
        started.append(process)
        return process

    yield run
    for process in started:
        if process.returncode is None:
            process.kill()
            await process.communicate()


def state_is(place, state):
    def reached():
        status = read_status(place / "run")
        return status is not None and status.state == state

    return reached


async def test_runs_tells_its_status_and_ends_on_sigterm(cloud, start, place, capsys):
    agent = await start(cloud, "run")
    await eventually(state_is(place, "connected"), lambda: "connected")
    environ = agent_environ(cloud, place)
    assert command.main(["status"], environ) == 0
    out = capsys.readouterr().out
    assert out.startswith("state         connected since")
    assert "rosbridge     down" in out or "rosbridge     unknown" in out
    clients = descendants(agent.pid)
    for pid in (agent.pid, *clients):
        # As systemd does: to the main process first, then to all others, of which it may have ended some.
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGTERM)
    _, log = await asyncio.wait_for(agent.communicate(), WAIT_S)
    assert agent.returncode == 0, log.decode()
    assert clients
    assert "another one follows" not in log.decode()
    assert not set(clients) & set(descendants(os.getpid()))
    assert "robot sim1: connected to 127.0.0.1 port" in log.decode()
    assert command.main(["status"], environ) == 1
    assert capsys.readouterr().out.startswith("state         stopped since")


async def test_killed_agent_leaves_nothing_behind(cloud, start, place):
    agent = await start(cloud, "run")
    await eventually(state_is(place, "connected"), lambda: "connected")
    await cloud.link("media")
    started = descendants(agent.pid)
    agent.kill()
    await agent.wait()
    await eventually(
        lambda: not cloud.of_kind("session") and not cloud.of_kind("media"),
        lambda: "both links have ended",
    )
    await eventually(lambda: not any(map(is_alive, started)), lambda: "all have ended")


@pytest.fixture
def environ(place):
    return {"NOTIFY_SOCKET": str(place / "notify"), "WATCHDOG_USEC": "400000"}


@pytest.fixture
def notify_socket(place):
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(place / "notify"))
        listening.setblocking(False)
        yield listening
    for number, handler in before.items():
        signal.signal(number, handler)


def failing(error):
    class Failing:
        def __init__(self, *_):
            raise error

    return Failing


def said(notify_socket):
    found = []
    with suppress(BlockingIOError):
        while True:
            found.append(notify_socket.recv(1000).decode())
    return found


def test_failed_start_pauses_before_systemd_starts_the_agent_again(
    monkeypatch, place, environ, notify_socket, capfd
):
    """The pause is no hanging loop: the watchdog gets its signs of life. The journal has what a developer needs."""
    monkeypatch.setattr(command, "Agent", failing(ZeroDivisionError("a defect")))
    monkeypatch.setattr(command, "before_restart", lambda *_: 0.5)
    began = time.monotonic()
    assert command.run(Settings(server="a.example", run_dir=place, guard="off"), environ) == 1
    assert time.monotonic() - began >= 0.5
    output = said(notify_socket)
    assert output[0] == "STATUS=failed; starts again in 0 s"
    assert output[-1] == "STOPPING=1"
    assert output.count("WATCHDOG=1") >= 2
    printed = capfd.readouterr().err
    assert "stopped by an error in the agent itself" in printed
    assert "ZeroDivisionError: a defect" in printed


def test_pause_ends_when_the_service_is_stopped(monkeypatch, place, environ, notify_socket):
    monkeypatch.setattr(command, "Agent", failing(AlreadyRunningError("cannot start")))
    monkeypatch.setattr(command, "before_restart", lambda *_: 60.0)
    stop = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGTERM))
    stop.start()
    began = time.monotonic()
    assert command.run(Settings(server="a.example", run_dir=place, guard="off"), environ) == 0
    assert time.monotonic() - began < 30
    stop.join()


def test_no_pause_where_nobody_starts_it_again(monkeypatch, place, environ, notify_socket, capfd):
    monkeypatch.setattr(command, "before_restart", lambda *_: pytest.fail("it pauses"))
    settings = Settings(server="a.example", run_dir=place, guard="off")
    monkeypatch.setattr(command, "Agent", failing(AlreadyRunningError("cannot start")))
    assert command.run(settings, {"JOURNAL_STREAM": "1:2"}) == AlreadyRunningError.exit_code
    [line] = capfd.readouterr().err.splitlines()
    assert line == "<2>STOPPED: cannot start [already_running]"
    monkeypatch.setattr(command, "Agent", failing(ServerKeyChangedError("another key")))
    assert command.run(settings, environ) == ServerKeyChangedError.exit_code


def teardown_module():
    logging.getLogger().handlers.clear()


def test_without_systemd_there_is_no_state(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert systemd.state() is None
    with pytest.raises(UpgradeFailedError, match="cannot run systemctl"):
        systemd.reload_units()
