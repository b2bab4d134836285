"""Which of the server's addresses is tried, and in which order."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Any
from unittest.mock import Mock

import pytest
from fake_cloud import FakeCloud, eventually
from openssh_server import OpenSshServer, listens
from robotether_agent import __version__
from robotether_agent.clock import EpochClock
from robotether_agent.daemon import report_guard, report_health
from robotether_agent.enrolment.join import parse_host_keys
from robotether_agent.enrolment.keys import KeyPair, ensure_key, pin_host_keys
from robotether_agent.guard.supervisor import GuardSupervisor
from robotether_agent.health import Health
from robotether_agent.net.server_dialer import SshAddress
from robotether_agent.problems import AgentError
from robotether_agent.rosbridge import RosGraph
from robotether_agent.settings import MAX_RUN_DIR_LENGTH
from robotether_agent.tunnel.connection import Report, Role, run_connection
from robotether_agent.tunnel.openssh import ServiceAddress, SshFiles
from robotether_agent.tunnel.session import Session, SessionConfig
from robotether_agent.tunnel.tunnel import Tunnel
from robotether_agent.video.sources import SourceSettings


@dataclass
class Up:
    configs: list[SessionConfig] = field(default_factory=list)
    ports_were_open: bool = True

    def note(self, _: SshAddress, config: SessionConfig, __: Session) -> None:
        self.configs.append(config)
        self.ports_were_open &= listens(config.ports["video"])

    @property
    def ports(self) -> list[int]:
        return [config.ports["video"] for config in self.configs]


@dataclass
class Robot:
    key: KeyPair
    files: SshFiles
    started: list[asyncio.Future[Any]] = field(default_factory=list)

    def trust(self, ssh: OpenSshServer) -> SshAddress:
        pin_host_keys(self.files.known_hosts, parse_host_keys({"host_keys": ssh.host_keys}))
        return SshAddress("127.0.0.1", ssh.port, ssh.user)

    def connect(
        self,
        target: SshAddress,
        up: Up,
        health: Health | None = None,
        recheck: asyncio.Event | None = None,
        **more: Any,
    ) -> asyncio.Future[Any]:
        """Start a connection whose forward leads nowhere, unless told otherwise."""
        usual = Role(
            kind="media" if health is None else "session",
            target=lambda: ServiceAddress("127.0.0.1", 9),
            on_up=up.note,
            reports=[] if health is None else reports_of(health, more.get("guard")),
            recheck=recheck,
        )
        role = replace(usual, **more)
        self.started.append(asyncio.ensure_future(run_connection(target, self.files, role)))
        return self.started[-1]


def reports_of(health: Health, guard: GuardSupervisor | None) -> list[Report]:
    reports = [partial(report_health, health, guard, EpochClock())]
    return [*reports, *([] if guard is None else [partial(report_guard, guard)])]


@pytest.fixture
async def robot(place) -> AsyncIterator[Robot]:
    key = await ensure_key(place)
    made = Robot(key, SshFiles((key.path,), place / "known_hosts", place / "session.ctl"))
    yield made
    for connection in made.started:
        connection.cancel()
        with suppress(asyncio.CancelledError, AgentError):
            await connection
    assert not made.files.control.exists()


@pytest.fixture
async def cloud(make_cloud, robot) -> FakeCloud:
    made = await make_cloud()
    made.authorize(robot.key.public)
    return made


def config(cloud: FakeCloud, video_port: int) -> dict[str, object]:
    times = {"heartbeat_s": 0.2, "timeout_s": 15.0}
    ports = {"ros_port": cloud.ports[0], "video_port": video_port}
    return {"type": "config", "robot": "sim1", "guard": {}, **ports, **times}


def no_services() -> Health:
    url = "ws://127.0.0.1:9"
    return Health(SourceSettings("http://127.0.0.1:9", url), RosGraph(url))


async def is_up(up: Up, count: int = 1) -> None:
    await eventually(lambda: len(up.configs) >= count, lambda: f"up {count} times: {up}")


async def problem_of(connection: asyncio.Future[Any]) -> AgentError:
    with pytest.raises(AgentError) as caught:
        await asyncio.wait_for(connection, 10)
    return caught.value


async def test_several_configurations_at_once_end_at_the_newest(cloud, robot):
    up = Up()
    connecting = robot.connect(robot.trust(cloud.ssh), up)
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


async def test_the_session_tells_each_change_once(cloud, robot, services):
    health = Health(
        SourceSettings(services.http_url, services.ws_url),
        RosGraph(services.ws_url),
        every_s=0.05,
    )
    probing = asyncio.ensure_future(health.run())
    robot.started.append(probing)
    robot.connect(robot.trust(cloud.ssh), Up(), health)
    link = await cloud.link("session")

    def said() -> list[tuple[str, str]]:
        return [(message["ros"], message["video"]) for message in link.of_type("health")]

    await eventually(lambda: ("ok", "ok") in said(), lambda: f"both are ok in {link.received}")
    services.video_status = 503
    await eventually(lambda: said()[-1:] == [("ok", "down")], lambda: f"video is down in {said()}")
    pings = len(link.of_type("ping"))
    await eventually(lambda: len(link.of_type("ping")) > pings + 2, lambda: "more heartbeats")
    assert all(before != after for before, after in pairwise(said()))
    who = {"hostname": socket.gethostname(), "agent_version": __version__}
    hello = {"type": "hello", **who, "guard": "off", "epoch": link.received[0]["epoch"]}
    assert link.received[0] == hello
    assert link.of_type("hello") == [hello]


async def test_the_guard_learns_of_a_lost_session_before_the_client_ends(cloud, robot, monkeypatch):
    """OpenSSH's client stays as long as connections through it do; a driver's is one."""

    async def never(*_: object, **__: object) -> AgentError:
        await asyncio.Event().wait()
        raise AssertionError

    monkeypatch.setattr(Tunnel, "why_ended", never)
    guard = Mock(spec=GuardSupervisor)
    robot.connect(robot.trust(cloud.ssh), Up(), no_services(), reports=[], guard=guard)
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
    robot.connect(robot.trust(cloud.ssh), Up(), no_services(), recheck)
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
    robot.connect(robot.trust(cloud.ssh), up)
    await is_up(up)
    assert listens(cloud.ports[1])
