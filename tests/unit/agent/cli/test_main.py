"""The command as it is started: by its name, with a real environment and real signals."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable

import pytest
from fake_cloud import FakeCloud, agent_environ, eventually
from openssh_server import descendants
from robotether_agent import __version__
from robotether_agent.cli.main import main
from robotether_agent.status import read_status


@pytest.fixture
async def start(place):
    """Starts `robotether-agent` as a process of its own."""
    started: list[Process] = []

    async def run(cloud: FakeCloud, command: str) -> Process:
        variables = {"PATH": os.environ["PATH"], "PYTHONPATH": ":".join(sys.path)}
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


def state_is(place, state: str) -> Callable[[], bool]:
    def reached() -> bool:
        status = read_status(place / "run")
        return status is not None and status.state == state

    return reached


async def test_runs_tells_its_status_and_ends_on_sigterm(make_cloud, start, place):
    """A connected agent says so with exit code 0, and SIGTERM ends it and its clients in time."""
    cloud = await make_cloud()
    agent = await start(cloud, "run")
    await eventually(state_is(place, "connected"), lambda: "connected")
    asked = await start(cloud, "status")
    out, _ = await asyncio.wait_for(asked.communicate(), 10)
    assert asked.returncode == 0
    assert out.decode().startswith("state         connected since")
    assert "rosbridge     down" in out.decode() or "rosbridge     unknown" in out.decode()
    clients = descendants(agent.pid)
    agent.send_signal(signal.SIGTERM)
    _, log = await asyncio.wait_for(agent.communicate(), 6)
    assert agent.returncode == 0, log.decode()
    assert clients
    assert not set(clients) & set(descendants(os.getpid()))
    assert "robot sim1: connected to 127.0.0.1 port" in log.decode()
    asked = await start(cloud, "status")
    out, _ = await asyncio.wait_for(asked.communicate(), 10)
    assert asked.returncode == 1
    assert out.decode().startswith("state         stopped since")


async def test_sigterm_while_it_waits(make_cloud, start, place):
    """A robot that waits for its approval stops at once, too."""
    cloud = await make_cloud("pending")
    agent = await start(cloud, "run")
    await eventually(state_is(place, "pending"), lambda: "pending")
    agent.send_signal(signal.SIGTERM)
    _, log = await asyncio.wait_for(agent.communicate(), 3)
    assert agent.returncode == 0
    assert "robotether robot approve robot-00000a" in log.decode()


async def test_killed_agent_leaves_no_clients(make_cloud, start, place):
    """Even when the agent is killed its SSH clients end by themselves."""
    cloud = await make_cloud()
    agent = await start(cloud, "run")
    await eventually(state_is(place, "connected"), lambda: "connected")
    await cloud.link("media")
    agent.kill()
    await agent.wait()
    await eventually(
        lambda: not cloud.of_kind("session") and not cloud.of_kind("media"),
        lambda: "both links have ended",
    )


async def test_changed_host_key_has_its_exit_code(make_cloud, start, place):
    """Systemd sees 76 and does not start it again; the log shouts."""
    cloud = await make_cloud()
    agent = await start(cloud, "run")
    await eventually(state_is(place, "connected"), lambda: "connected")
    cloud.ssh.stop()
    cloud.ssh.new_host_key()
    cloud.ssh.start()
    _, log = await asyncio.wait_for(agent.communicate(), 20)
    assert agent.returncode == 76
    assert "STOPPED: cannot trust 127.0.0.1 port" in log.decode()


def test_status_of_an_agent_that_never_ran(place, capsys):
    """Without a status file the command says how to start the agent."""
    variables = {"ROBOTETHER_SERVER": "a.example", "ROBOTETHER_RUN_DIR": str(place)}
    assert main(["status"], variables) == 1
    assert "sudo systemctl start robotether-agent" in capsys.readouterr().out


def test_show_settings_prints_all_and_hides_secrets(capsys):
    """Every key is there once, the token is not."""
    variables = {"ROBOTETHER_SERVER": "a.example", "ROBOTETHER_TOKEN": "s3cret"}
    assert main(["show-settings"], variables) == 0
    out = capsys.readouterr().out
    assert "server = a.example" in out
    assert "token = (hidden)" in out
    assert "s3cret" not in out


def test_wrong_settings_have_their_exit_code(capsys):
    """Systemd sees 78, and the person a sentence."""
    assert main(["run"], {"ROBOTETHER_SERVER": "https://a"}) == 78
    assert "cannot use ROBOTETHER_SERVER" in capsys.readouterr().err


def test_version(capsys):
    with pytest.raises(SystemExit) as error:
        main(["--version"], {})
    assert error.value.code == 0
    assert capsys.readouterr().out == f"robotether-agent {__version__}\n"
