"""The way over SSH, with a real sshd, and what is made of the agent's own status."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import pytest
from fake_cloud import agent_environ
from robotether_agent.doctor import FAIL, OK, SKIPPED, WARNING, Finding, tunnel
from robotether_agent.enrolment.enroller import Enroller
from robotether_agent.enrolment.join import SshAccess
from robotether_agent.settings import Settings, load
from robotether_agent.status import Status

UP = Status(
    state="connected",
    robot="sim1",
    ssh="b.example port 443",
    video_tunnel="open",
    end_to_end_ros="ok",
    end_to_end_video="ok",
    pid=7,
)
LOST = replace(UP, problem="lost it", problem_code="link_lost")
Check = Callable[[Status | None], Finding]


@pytest.fixture
async def settings(cloud, place) -> Settings:
    made = load(None, agent_environ(cloud, place))
    await Enroller(made).enrolment()
    return made


def test_the_join(settings, place):
    assert tunnel.check_join(settings, None).state == OK
    pending = Status(state="pending", problem="not yet", fingerprint="SHA256:abc")
    assert "not yet (key SHA256:abc)" in tunnel.check_join(settings, pending).detail
    fresh = replace(settings, state_dir=place / "fresh")
    assert "robotether-agent join" in tunnel.check_join(fresh, None).advice
    (settings.state_dir / "known_hosts").write_text("rubbish\n")
    assert tunnel.check_join(settings, None).state == FAIL


async def test_one_port_is_enough(settings, cloud):
    both = replace(settings, ssh_ports=(cloud.other_ports[0], cloud.ssh.port))
    blocked, open_port = await tunnel.check_ssh(both, None, ())
    assert (blocked.state, open_port.state) == (SKIPPED, OK)
    assert "another address is enough" in blocked.detail
    cloud.ssh.stop()
    (both_closed,) = await tunnel.check_ssh(both, None, ())
    assert (both_closed.state, both_closed.detail.count("refused")) == (FAIL, 1)
    assert both_closed.step == f"ssh {cloud.other_ports[0]}, {cloud.ssh.port}"


async def test_a_path_that_loses_large_packets(settings, cloud, monkeypatch):
    """The server's first words come, and its long list of algorithms never does: no firewall is to blame."""
    monkeypatch.setattr(tunnel, "TIMEOUT_S", 0.5)
    cloud.ssh.stop()

    async def greet(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"SSH-2.0-OpenSSH_10.0\r\n")
        await reader.read()
        writer.close()

    async with await asyncio.start_server(greet, "127.0.0.1", cloud.ssh.port):
        (found,) = await tunnel.check_ssh(settings, None, ())
    assert found.state == FAIL
    assert "begins to answer, and then falls silent" in found.detail
    assert "MTU" in found.advice


async def test_before_the_first_join_nothing_is_pinned(settings, place, cloud):
    fresh = replace(settings, state_dir=place / "fresh")
    access = SshAccess("tunnel", None, (cloud.ssh.port,))
    (found,) = await tunnel.check_ssh(fresh, access, ())
    assert (found.state, found.step) == (SKIPPED, f"ssh {cloud.ssh.port}")
    assert "no host key is pinned" in found.detail
    (unknown,) = await tunnel.check_ssh(fresh, None, ())
    assert "has not said at which ports" in unknown.detail


READY = replace(UP, guard="ready")


def service(state: str | None) -> Check:
    return partial(tunnel.check_service, state)


def guard(setting: str) -> Check:
    return partial(tunnel.check_guard, Settings(server="a", guard=setting))


@pytest.mark.parametrize(
    ("check", "status", "expected", "words"),
    [
        (service("active"), UP, OK, ""),
        (service(None), UP, OK, ""),
        (service("failed"), UP, FAIL, ""),
        (service("inactive"), None, FAIL, ""),
        (service("active"), None, FAIL, ""),
        (tunnel.check_session, UP, OK, "connected to b.example port 443 as sim1"),
        (tunnel.check_session, None, SKIPPED, "no agent"),
        (tunnel.check_session, replace(UP, state="connecting"), FAIL, "the agent is connecting"),
        (tunnel.check_session, LOST, FAIL, "lost it [link_lost]"),
        (tunnel.check_session, replace(LOST, problem_over_at=5.0), OK, "as sim1"),
        (guard("on"), READY, OK, "ready"),
        (guard("off"), READY, SKIPPED, "nothing stops this robot"),
        (guard("on"), None, SKIPPED, "no agent runs"),
        (guard("on"), UP, FAIL, "it does not run"),
        (guard("on"), replace(UP, guard="down", guard_detail="it hangs"), FAIL, "it hangs"),
        (guard("on"), replace(READY, guard_detail="no listener"), WARNING, "no listener"),
        (guard("on"), replace(READY, stopped_by="ben"), SKIPPED, "stopped by ben"),
        # The server's own view counts; a shell only where one is wanted, video only where the robot has it.
        (tunnel.check_end_to_end, UP, OK, ""),
        (tunnel.check_end_to_end, None, SKIPPED, ""),
        (tunnel.check_end_to_end, replace(UP, state="waiting"), SKIPPED, ""),
        (tunnel.check_end_to_end, replace(UP, end_to_end_video="unknown"), SKIPPED, ""),
        (tunnel.check_end_to_end, replace(UP, end_to_end_ros="down"), FAIL, ""),
        (tunnel.check_end_to_end, replace(UP, video="ok", end_to_end_video="down"), FAIL, ""),
        (tunnel.check_end_to_end, replace(UP, video="down", end_to_end_video="down"), OK, ""),
        (
            tunnel.check_end_to_end,
            replace(UP, shell_tunnel="open", end_to_end_shell="down"),
            FAIL,
            "",
        ),
        (tunnel.check_end_to_end, replace(UP, end_to_end_shell="down"), OK, ""),
    ],
)
def test_what_the_agent_says_of_itself(check: Check, status, expected, words):
    """What is wrong comes with its advice."""
    found = check(status)
    assert found.state == expected
    assert words in found.detail
    assert bool(found.advice) == (expected in {FAIL, WARNING})
