"""The join over real TLS, and what each answer means."""

import json
from dataclasses import replace
from datetime import datetime, timedelta, timezone

import pytest
from aiohttp import web
from dated_certificate import fingerprint_of, make_certificate
from fake_cloud import FakeCloud, fingerprint
from fake_proxy import FakeProxy
from robotether_agent.enrolment.join import JoinRequest, join, read_answer
from robotether_agent.problems import (
    AnswerInvalidError,
    JoinRefusedError,
    NotEnrolledError,
    Retry,
    ServerUnreachableError,
    TlsUntrustedError,
)
from robotether_agent.settings import Settings

REQUEST = JoinRequest(
    mac="00:1b:44:11:3a:b7",
    public_key="ssh-ed25519 AAAA",
    hostname="turtle",
    agent_version="0.1.0",
    token="t",
)
KEY = "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIJXwzyV7Yl1cYqPGRkvnkSnMuRlWZ2EiJkXYh2JYQ0bF"
SSH = {"user": "tunnel", "host": None, "ports": [2222, 443], "host_keys": [KEY]}


def answer(**changes):
    return json.dumps({"state": "active", "robot": "sim1", "ssh": {**SSH, **changes}}).encode()


async def test_other_certificate_is_not_trusted(cloud):
    """Neither a wrong fingerprint nor an unknown authority gets the request, and the sentence says which."""
    with pytest.raises(TlsUntrustedError, match="not the pinned one") as pinned:
        await join(Settings(server=cloud.server, tls_fingerprint=b"\0" * 32), REQUEST)
    assert fingerprint() in pinned.value.message.replace(":", "")
    with pytest.raises(TlsUntrustedError, match="clock is right"):
        await join(Settings(server=cloud.server), REQUEST)
    assert cloud.joins == []


def behind(proxy_url, cloud):
    pin = bytes.fromhex(fingerprint())
    return Settings(server=cloud.server, tls_fingerprint=pin, http_proxy=proxy_url)


async def test_through_a_proxy(cloud):
    async with FakeProxy("needs_password") as proxy:
        url = proxy.url.replace("//", "//robot:s3cret%2F%40%3A@")
        assert (await join(behind(url, cloud), REQUEST)).robot == "sim1"
        assert proxy.asked == [cloud.server]
        with pytest.raises(TlsUntrustedError, match="not the pinned one"):
            await join(replace(behind(url, cloud), tls_fingerprint=b"\0" * 32), REQUEST)


@pytest.mark.parametrize(
    ("mode", "words"),
    [
        ("refuses", "answers 403 Forbidden; .*lets CONNECT out"),
        ("needs_password", "answers 407 .*USER:PASSWORD"),
    ],
)
async def test_a_proxy_that_does_not_let_it_through(cloud, mode, words):
    async with FakeProxy(mode) as proxy:
        with pytest.raises(ServerUnreachableError, match=words) as caught:
            await join(behind(proxy.url, cloud), REQUEST)
        assert f"the HTTP proxy 127.0.0.1 port {proxy.port}" in str(caught.value)


async def test_redirects_and_endless_answers_are_refused(cloud):
    """A captive portal's redirect is not followed, and no answer fills the memory."""
    settings = Settings(server=cloud.server, tls_fingerprint=bytes.fromhex(fingerprint()))
    cloud.answer = lambda: web.Response(status=302, headers={"Location": "https://127.0.0.1:1/"})
    with pytest.raises(AnswerInvalidError, match="HTTP status 302") as redirected:
        await join(settings, REQUEST)
    assert "captive portal" in redirected.value.advice
    cloud.answer = lambda: web.Response(body=b"x" * 200_000)
    with pytest.raises(ServerUnreachableError, match="longer than"):
        await join(settings, REQUEST)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"user": "-oProxyCommand=x"}, "user"),
        ({"host": "-oProxyCommand=x"}, "host"),
        ({"host": "a b"}, "host"),
        ({"ports": [0]}, r"ports\[0\]"),
        ({"ports": "2222"}, "ports"),
        ({"host_keys": []}, "host_keys"),
        ({"host_keys": ["ssh-ed25519 AAAA\n* ssh-ed25519 AAAA"]}, "host_keys"),
        ({"host_keys": ["ssh-dss AAAA"]}, "host_keys"),
        ({"host_keys": ["ssh-rsa " + KEY.split()[1]]}, "another type"),
    ],
)
def test_wrong_field_of_the_answer_is_named(changes, field):
    """Nothing that could become an option of ssh or a second line of known_hosts gets through."""
    with pytest.raises(AnswerInvalidError, match=field):
        read_answer("a.example", 200, answer(**changes))


@pytest.mark.parametrize(
    ("status", "code", "kind", "retry"),
    [
        (202, "approval_pending", NotEnrolledError, Retry.ASK_AGAIN),
        (403, "robot_disabled", JoinRefusedError, Retry.SLOWLY),
        (202, "mac_in_use", NotEnrolledError, Retry.ASK_AGAIN),
        (401, "token_invalid", JoinRefusedError, Retry.SLOWLY),
        (403, "key_rejected", JoinRefusedError, Retry.SLOWLY),
        (409, "key_in_use", JoinRefusedError, Retry.SLOWLY),
        (429, "too_many_pending", JoinRefusedError, Retry.ASK_AGAIN),
    ],
)
def test_each_refusal_keeps_its_reason(status, code, kind, retry):
    body = json.dumps({"code": code, "detail": "the reason"}).encode()
    with pytest.raises(kind, match="the reason") as error:
        read_answer("a.example", status, body)
    assert error.value.retry is retry
    # The server's own sentence for an approval says how it is given.
    assert error.value.advice or code == "approval_pending"
    assert "ask the server's administrator" not in error.value.advice
    assert error.value.code == ("not_enrolled" if kind is NotEnrolledError else code)


@pytest.mark.parametrize(
    ("status", "body", "kind"),
    [
        (502, b"<html>", ServerUnreachableError),
        (200, b"<html>Welcome to the hotel", AnswerInvalidError),
        (404, b"{}", AnswerInvalidError),
        (200, b'{"state": "pending"}', AnswerInvalidError),
    ],
)
def test_other_servers_are_told_apart(status, body, kind):
    with pytest.raises(kind):
        read_answer("a.example", status, body)


@pytest.mark.parametrize(
    ("begin", "end", "why"),
    [(+300, +600, "not yet valid"), (-600, -300, "expired")],
)
async def test_a_wrong_clock_is_told_as_such_and_no_matter_with_a_pin(place, begin, end, why):
    now = datetime.now(timezone.utc)
    dates = (now + timedelta(days=days) for days in (begin, end))
    pem = make_certificate(place, *dates)
    cloud = FakeCloud(pem=pem)
    await cloud.start()
    try:
        with pytest.raises(TlsUntrustedError, match=f"this robot's clock says 20.* {why}") as error:
            await join(Settings(server=cloud.server, ca_file=pem), REQUEST)
        assert "with tls_fingerprint set the clock does not matter" in error.value.advice
        pinned = bytes.fromhex(fingerprint_of(pem))
        assert (await join(Settings(server=cloud.server, tls_fingerprint=pinned), REQUEST)).robot
    finally:
        await cloud.close()
