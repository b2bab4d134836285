"""Which of the server's addresses is tried, and in which order."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import NoReturn

import pytest
from fake_cloud import echo, eventually
from fake_proxy import FakeProxy
from robotether_agent.enrolment.enroller import Enroller
from robotether_agent.enrolment.enrolment_store import Enrolment, SshAccess
from robotether_agent.settings import Settings
from robotether_agent.tunnel.connector import Connector


@pytest.mark.parametrize(
    ("host", "settings", "expected"),
    [
        (None, {}, ["a.example port 2222", "a.example port 443"]),
        ("ssh.example", {}, ["ssh.example port 2222", "ssh.example port 443"]),
        ("ssh.example", {"ssh_host": "b.example", "ssh_ports": (22,)}, ["b.example port 22"]),
    ],
)
def test_the_settings_come_before_the_joins_answer(host, settings, expected):
    """And a join that names no host means the one that it went to."""
    values = Settings(server="a.example:8443", state_dir=Path("/none"), **settings)
    enrolment = Enrolment(
        "a.example:8443", "sim1", "00:1b:44:11:3a:b7", SshAccess("tunnel", host, (2222, 443))
    )
    targets = Connector(values, Enroller(values)).targets(enrolment)
    assert [str(target) for target in targets] == expected


async def test_silence_is_no_reason_to_doubt(make_cloud, place, start_agent, monkeypatch):
    """While nothing answers the robot says no_answer, and comes back without asking the web first."""
    cloud = await make_cloud()
    agent = start_agent(cloud)
    await agent.until_connected()
    joins = len(cloud.joins)
    monkeypatch.setattr("robotether_agent.net.server_dialer.FIND_TIMEOUT_S", 0.2)
    with monkeypatch.context() as cut:
        cut.setattr("robotether_agent.net.tcp._connect", _never)
        cloud.ssh.drop_connections()
        await agent.until(lambda status: status.problem_code == "no_answer", "no answer")
    await agent.until_connected()
    assert len(cloud.joins) == joins


async def test_a_server_that_moved_is_found_by_the_web(make_cloud, start_agent, monkeypatch):
    """After a longer silence the web is asked, beside the attempts."""
    monkeypatch.setattr("robotether_agent.net.server_dialer.FIND_TIMEOUT_S", 1.0)
    monkeypatch.setattr("robotether_agent.tunnel.connector.ASK_WEB_AFTER_S", 0.0)
    monkeypatch.setattr("robotether_agent.tunnel.connector.ASK_WEB_EVERY_S", 0.0)
    cloud = await make_cloud()
    agent = start_agent(cloud)
    await agent.until_connected()
    joins = len(cloud.joins)
    with monkeypatch.context() as cut:
        cut.setattr("robotether_agent.net.tcp._connect", _never)
        cloud.ssh.drop_connections()
        await eventually(lambda: len(cloud.joins) > joins, lambda: "the web was asked")
    await agent.until_connected()


async def test_all_goes_through_the_proxy(make_cloud, start_agent):
    """Where only a proxy leads out, it is asked for the web and for SSH, by their names."""
    cloud = await make_cloud()
    async with FakeProxy() as proxy:
        agent = start_agent(cloud, http_proxy=proxy.url)
        await agent.until_connected()
        assert set(proxy.asked) == {cloud.server, f"127.0.0.1:{cloud.ssh.port}"}
        assert await echo(cloud.ports[0], "through") == "through"
        await agent.stop()


async def _never(*_: object) -> NoReturn:
    """Packets are dropped."""
    await asyncio.Event().wait()
    raise AssertionError("nothing sets it")
