"""CONNECT: what is asked, what each answer means, and what is never told."""

from __future__ import annotations

import pytest
from fake_proxy import PASSWORD, SECRET, USER, FakeProxy
from robotether_agent.net.http_proxy import Proxy, ask_for, proxy_of, refusal, request
from robotether_agent.net.tcp import Resolver, connect
from robotether_agent.problems import NoAnswerError, ServerUnreachableError


@pytest.mark.parametrize(
    ("url", "proxy"),
    [
        (None, None),
        ("", None),
        ("http://proxy.example:8080", Proxy("proxy.example", 8080)),
        ("http://[2001:db8::1]:8080", Proxy("2001:db8::1", 8080)),
        ("http://a%40b:c%3Ad@proxy.example:8080", Proxy("proxy.example", 8080, "a@b", "c:d")),
    ],
)
def test_the_setting_is_read(url, proxy):
    assert proxy_of(url) == proxy


def test_the_password_is_in_no_text():
    proxy = Proxy("proxy.example", 8080, USER, PASSWORD)
    assert PASSWORD not in f"{proxy} {proxy!r}"
    assert SECRET in request(proxy, "h", 443).decode()


@pytest.mark.parametrize(
    ("head", "kind", "words"),
    [
        (b"HTTP/1.1 200 Connection established\r\n\r\n", None, ""),
        (b"HTTP/1.0 200\r\nVia: x\r\n\r\n", None, ""),
        (
            b"HTTP/1.1 403 Forbidden\r\n\r\n",
            ServerUnreachableError,
            "p port 1 answers 403 Forbidden",
        ),
        (b"HTTP/1.1 407 Who?\r\n\r\n", ServerUnreachableError, "USER:PASSWORD"),
        (b"HTTP/1.1 504 Too late\r\n\r\n", NoAnswerError, "504 Too late"),
        (b"HTTP/1.1 403 \x1b[31m\r\n\r\n", ServerUnreachableError, "403"),
        (b"SSH-2.0-OpenSSH_9.2\r\n\r\n", ServerUnreachableError, "not HTTP"),
        (b"HTTP/1.1 200 " + b"x" * 9000, ServerUnreachableError, "not HTTP"),
    ],
)
def test_each_answer_is_told(head, kind, words):
    problem = refusal(head, Proxy("p", 1), "h port 22")
    if kind is None:
        assert problem is None
        return
    assert isinstance(problem, kind)
    assert words in str(problem)
    assert "\x1b" not in str(problem)


async def ask(url: str) -> None:
    proxy = proxy_of(url)
    assert proxy is not None
    with await connect(proxy.host, proxy.port, Resolver(), "the proxy") as connection:
        await ask_for(connection, proxy, "127.0.0.1", 9)


@pytest.mark.parametrize(
    ("mode", "kind", "words"),
    [
        ("closes", ServerUnreachableError, "closes the connection"),
        ("silent", NoAnswerError, "does not answer"),
    ],
)
async def test_a_proxy_without_an_answer_is_named(monkeypatch, mode, kind, words):
    monkeypatch.setattr("robotether_agent.net.http_proxy.TIMEOUT_S", 0.1)
    async with FakeProxy(mode) as proxy:
        with pytest.raises(kind, match=words) as caught:
            await ask(proxy.url)
        assert f"the HTTP proxy 127.0.0.1 port {proxy.port}" in str(caught.value)
