"""One connection with a real sshd: what its configurations change, and who learns of its end."""

import asyncio
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any
from unittest.mock import Mock

import pytest
from fake_cloud import eventually
from openssh_server import listens
from robotether_agent.enrolment.join import parse_host_keys
from robotether_agent.enrolment.keys import KeyPair, ensure_key, pin_host_keys
from robotether_agent.guard.supervisor import GuardSupervisor
from robotether_agent.net.server_dialer import SshAddress
from robotether_agent.problems import AgentError
from robotether_agent.settings import MAX_RUN_DIR_LENGTH
from robotether_agent.tunnel.connection import Role, run_connection
from robotether_agent.tunnel.openssh import ServiceAddress, SshFiles
from robotether_agent.tunnel.session import SessionConfig
from robotether_agent.tunnel.tunnel import Tunnel


@dataclass
class Up:
    configs: list[SessionConfig] = field(default_factory=list)
    ports_were_open: bool = True

    def note(self, _, config, __):
        self.configs.append(config)
        self.ports_were_open &= listens(config.ports["video"])

    @property
    def ports(self):
        return [config.ports["video"] for config in self.configs]


@dataclass
class Robot:
    key: KeyPair
    files: SshFiles
    started: list[asyncio.Future[Any]] = field(default_factory=list)

    def connect(self, ssh, up, kind="media", **more):
        """Start a connection whose forward leads nowhere."""
        pin_host_keys(self.files.known_hosts, parse_host_keys({"host_keys": ssh.host_keys}))
        role = Role(kind=kind, target=lambda: ServiceAddress("127.0.0.1", 9), on_up=up.note, **more)
        target = SshAddress("127.0.0.1", ssh.port, ssh.user)
        self.started.append(asyncio.ensure_future(run_connection(target, self.files, role)))
        return self.started[-1]


@pytest.fixture
async def robot(place):
    key = await ensure_key(place)
    made = Robot(key, SshFiles((key.path,), place / "known_hosts", place / "session.ctl"))
    yield made
    for connection in made.started:
        connection.cancel()
        with suppress(asyncio.CancelledError, AgentError):
            await connection
    assert not made.files.control.exists()


@pytest.fixture
async def cloud(make_cloud, robot):
    made = await make_cloud()
    made.authorize(robot.key.public)
    return made


def config(cloud, video_port):
    times = {"heartbeat_s": 0.2, "timeout_s": 15.0}
    ports = {"ros_port": cloud.ports[0], "video_port": video_port}
    return {"type": "config", "robot": "sim1", "guard": {}, **ports, **times}


async def is_up(up):
    await eventually(lambda: bool(up.configs), lambda: f"it is up: {up}")


async def test_several_configurations_at_once_end_at_the_newest(cloud, robot):
    up = Up()
    connecting = robot.connect(cloud.ssh, up)
    await is_up(up)
    link = await cloud.link("media")
    for port in (*cloud.other_ports, cloud.ports[0]):
        link.send(config(cloud, port))
    # Each change is two commands of OpenSSH's, and up to three changes are made.
    await eventually(
        lambda: up.ports[-1] == cloud.ports[0], lambda: f"the newest port: {up}, {connecting}", 30
    )
    assert up.ports_were_open
    assert not any(map(listens, (cloud.ports[1], *cloud.other_ports)))


async def test_the_guard_learns_of_a_lost_session_before_the_client_ends(cloud, robot, monkeypatch):
    """OpenSSH's client stays as long as connections through it do; a driver's is one."""

    async def never(*_, **__):
        await asyncio.Event().wait()
        raise AssertionError

    monkeypatch.setattr(Tunnel, "why_ended", never)
    guard = Mock(spec=GuardSupervisor)
    robot.connect(cloud.ssh, Up(), "session", guard=guard)
    link = await cloud.link("session")
    await eventually(lambda: guard.on_config.called, lambda: "the session is up")
    link.drop()
    await eventually(lambda: guard.on_session_lost.called, lambda: "the guard was told")


@pytest.mark.parametrize("idle_heartbeat_s", [None, 0.3])
async def test_a_robot_that_nobody_uses_asks_for_checks_seldom(
    cloud, robot, monkeypatch, idle_heartbeat_s
):
    monkeypatch.setattr("robotether_agent.tunnel.connection.CHECK_PAUSE_S", 0)
    monkeypatch.setattr("robotether_agent.tunnel.connection.CHECK_EVERY_S", 0.1)
    cloud.idle_heartbeat_s = idle_heartbeat_s
    recheck = asyncio.Event()
    robot.connect(cloud.ssh, Up(), "session", recheck=recheck)
    link = await cloud.link("session")
    await eventually(lambda: len(link.of_type("ping")) > 0, lambda: f"pings in {link.received}")
    recheck.set()
    pings = len(link.of_type("ping"))
    await eventually(
        lambda: len(link.of_type("ping")) > pings + 3, lambda: f"pings in {link.received}"
    )
    checks = len(link.of_type("check"))
    assert checks == 1 if idle_heartbeat_s else checks > 1


async def test_the_longest_run_directory_takes_its_control_socket(cloud, robot, place):
    run_dir = place / ("x" * (MAX_RUN_DIR_LENGTH - len(str(place)) - 1))
    run_dir.mkdir()
    assert len(str(run_dir)) == MAX_RUN_DIR_LENGTH
    robot.files = replace(robot.files, control=run_dir / "session.ctl")
    up = Up()
    robot.connect(cloud.ssh, up)
    await is_up(up)
    assert listens(cloud.ports[1])
