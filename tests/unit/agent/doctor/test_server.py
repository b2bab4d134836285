"""How the doctor sees the server: TLS on this machine, the way over SSH, and the agent's own status."""

import asyncio
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from functools import partial

import pytest
from aiohttp import web
from fake_cloud import agent_environ, certificate, fingerprint
from fake_proxy import FakeProxy
from local_network import free_port
from robotether_agent.describe_error import Cause
from robotether_agent.doctor import FAIL, OK, SKIPPED, WARNING, server, tunnel
from robotether_agent.doctor.server import ServerView, view_server
from robotether_agent.enrolment.enroller import Enroller
from robotether_agent.settings import Settings, load
from robotether_agent.status import Status

NOW = datetime(2026, 3, 1, 12, 0, tzinfo=timezone.utc)
PINNED = bytes.fromhex(fingerprint())


def all_checks(seen, pinned=PINNED):
    now = datetime.now(timezone.utc)
    found = [
        server.check_name(seen),
        server.check_port(seen),
        server.check_certificate(seen, pinned),
        server.check_clock(seen, now, is_pinned=pinned is not None),
        server.check_answer(seen),
    ]
    return {finding.step: finding for finding in found}


def states(seen):
    return [finding.state for finding in all_checks(seen).values()]


async def test_the_robots_proxy_is_gone_through(cloud):
    async with FakeProxy() as proxy:
        settings = Settings(server=cloud.server, tls_fingerprint=PINNED, http_proxy=proxy.url)
        seen = await view_server(settings)
    assert states(seen) == [SKIPPED, OK, OK, OK, OK]
    assert proxy.asked == [cloud.server] * 3


async def test_an_authority_is_asked_when_nothing_is_pinned(cloud):
    found = all_checks(await view_server(Settings(server=cloud.server)), None)["certificate"]
    assert found.state == FAIL
    assert "self-signed" in found.detail
    assert "tls_fingerprint or ca_file" in found.advice
    trusted = await view_server(Settings(server=cloud.server, ca_file=certificate()))
    assert all_checks(trusted, None)["certificate"].state == OK


async def test_what_follows_a_failure_is_skipped():
    seen = await view_server(Settings(server="no-such-host.invalid"))
    assert states(seen) == [FAIL, SKIPPED, SKIPPED, OK, SKIPPED]
    seen = await view_server(Settings(server=f"127.0.0.1:{free_port()}"))
    assert states(seen) == [OK, FAIL, SKIPPED, OK, SKIPPED]
    assert "Connection refused" in all_checks(seen)["https port"].detail


@pytest.mark.parametrize(
    ("date", "clock"),
    [
        ("Thu Jan  1 00:00:10 1970", FAIL),
        ("today", OK),
        ("Sun, 01 Mar 99999999999 00:00:00 GMT", OK),
        ("Sun, 01 Mar 2026 00:00:00 GMT", FAIL),
    ],
)
async def test_a_portal_may_write_any_date(cloud, date, clock):
    cloud.greeting = lambda: web.Response(text="<html>Welcome", headers={"Date": date})
    seen = await view_server(Settings(server=cloud.server, tls_fingerprint=PINNED))
    found = all_checks(seen)["answer"]
    assert (found.state, "portal" in found.advice) == (FAIL, True)
    assert "not a Robotether server" in found.detail
    now = datetime.now(timezone.utc)
    assert server.check_clock(seen, now, is_pinned=True).state == clock


def test_a_clock_is_compared_with_what_there_is():
    """Where the server says nothing only the year is judged."""
    nothing = ServerView("a.example", 443, no_address=Cause("x"))
    answered = replace(nothing, date=NOW)
    year_1970 = datetime(1970, 1, 1, tzinfo=timezone.utc)
    for seen, now, state, words in (
        (answered, NOW + timedelta(seconds=90), OK, ""),
        (answered, year_1970, FAIL, "1970-01-01 00:00:00 UTC, and the server's 2026-03-01"),
        (nothing, NOW, OK, ""),
        (nothing, year_1970, FAIL, "before this program was built"),
    ):
        found = server.check_clock(seen, now, is_pinned=False)
        assert (found.state, words in found.detail) == (state, True), found
    found = server.check_clock(answered, year_1970, is_pinned=True)
    assert "the tunnel works all the same" in found.advice


async def test_a_path_that_takes_only_small_packets(monkeypatch):
    """The port accepts, and TLS never comes: neither firewall nor portal is to blame."""
    monkeypatch.setattr(server, "TIMEOUT_S", 0.3)

    async def keep(reader, writer):
        await reader.read()
        writer.close()

    async with await asyncio.start_server(keep, "127.0.0.1", 0) as silent:
        port = silent.sockets[0].getsockname()[1]
        found = all_checks(await view_server(Settings(server=f"127.0.0.1:{port}")))
    assert found["https port"].state == OK
    assert "no answer in 0.3 s" in found["certificate"].detail
    assert "MTU" in found["certificate"].advice


async def test_only_a_server_that_is_trusted_says_where_robots_connect(cloud):
    seen = await view_server(Settings(server=cloud.server, tls_fingerprint=PINNED))
    assert seen.ssh.ports == (cloud.ssh.port,)
    impostor = await view_server(Settings(server=cloud.server, tls_fingerprint=b"\1" * 32))
    assert impostor.ssh is None


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


@pytest.fixture
async def settings(cloud, place):
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

    async def greet(reader, writer):
        writer.write(b"SSH-2.0-OpenSSH_10.0\r\n")
        await reader.read()
        writer.close()

    async with await asyncio.start_server(greet, "127.0.0.1", cloud.ssh.port):
        (found,) = await tunnel.check_ssh(settings, None, ())
    assert found.state == FAIL
    assert "begins to answer, and then falls silent" in found.detail
    assert "MTU" in found.advice


READY = replace(UP, guard="ready")


def service(state):
    return partial(tunnel.check_service, state)


def guard(setting):
    return partial(tunnel.check_guard, Settings(server="a", guard=setting))


@pytest.mark.parametrize(
    ("check", "status", "expected", "words"),
    [
        (service(None), UP, OK, ""),
        (service("failed"), UP, FAIL, ""),
        (service("active"), None, FAIL, "it writes no status"),
        (service(None), None, FAIL, "no agent runs"),
        (tunnel.check_session, UP, OK, "connected to b.example port 443 as sim1"),
        (tunnel.check_session, None, SKIPPED, "no agent"),
        (tunnel.check_session, replace(UP, state="connecting"), FAIL, "the agent is connecting"),
        (tunnel.check_session, LOST, FAIL, "lost it [link_lost]"),
        (tunnel.check_session, replace(LOST, problem_over_at=5.0), OK, "as sim1"),
        (guard("on"), READY, OK, "ready"),
        (guard("off"), None, SKIPPED, "nothing stops this robot"),
        (guard("off"), READY, OK, "ready"),
        (guard("on"), replace(UP, guard="off"), SKIPPED, "nothing stops this robot"),
        (guard("on"), None, SKIPPED, "no agent runs"),
        (guard("on"), UP, FAIL, "it does not run"),
        (guard("on"), replace(UP, guard="down", guard_detail="it hangs"), FAIL, "it hangs"),
        (guard("on"), replace(READY, guard_detail="no listener"), WARNING, "no listener"),
        (guard("on"), replace(READY, stopped_by="ben"), SKIPPED, "stopped by ben"),
        # The server's own view counts; a shell only where one is wanted, video only where the robot has it.
        (tunnel.check_end_to_end, UP, OK, ""),
        (tunnel.check_end_to_end, None, SKIPPED, ""),
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
def test_what_the_agent_says_of_itself(check, status, expected, words):
    """What is wrong comes with its advice."""
    found = check(status)
    assert found.state == expected
    assert words in found.detail
    assert bool(found.advice) == (expected in {FAIL, WARNING})
