"""How the server looks: real TLS on this machine, and pure checks of what could be seen."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from datetime import datetime, timedelta, timezone

import pytest
from aiohttp import web
from fake_cloud import certificate, fingerprint
from fake_proxy import FakeProxy
from local_network import free_port
from robotether_agent.describe_error import Cause
from robotether_agent.doctor import FAIL, OK, SKIPPED, Finding, server
from robotether_agent.doctor.server import ServerView, view_server
from robotether_agent.settings import Settings

NOW = datetime(2026, 3, 1, 12, 0, tzinfo=timezone.utc)
PINNED = bytes.fromhex(fingerprint())


def all_checks(seen: ServerView, pinned: bytes | None = PINNED) -> dict[str, Finding]:
    now = datetime.now(timezone.utc)
    found = [
        server.check_name(seen),
        server.check_port(seen),
        server.check_certificate(seen, pinned),
        server.check_clock(seen, now, is_pinned=pinned is not None),
        server.check_answer(seen),
    ]
    return {finding.step: finding for finding in found}


def states(seen: ServerView) -> list[str]:
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
    ("answer", "why"),
    [
        (web.Response(status=302, headers={"Location": "https://hotel/login"}), "hotel/login"),
        (web.Response(text="<html>Welcome to the hotel"), "not a Robotether server"),
    ],
)
async def test_a_captive_portal_is_told(cloud, answer, why):
    cloud.greeting = lambda: answer
    seen = await view_server(Settings(server=cloud.server, tls_fingerprint=PINNED))
    found = all_checks(seen)["answer"]
    assert found.state == FAIL
    assert why in found.detail
    assert "portal" in found.advice


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
    assert "not a Robotether server" in all_checks(seen)["answer"].detail
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

    async def keep(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
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
    assert seen.ssh is not None
    assert seen.ssh.ports == (cloud.ssh.port,)
    impostor = await view_server(Settings(server=cloud.server, tls_fingerprint=b"\1" * 32))
    assert impostor.ssh is None
