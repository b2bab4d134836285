"""Problems and reasons: the exception tree, its exit codes, and words that a person can use."""

import asyncio
import errno
import re
import socket
import ssl
from pathlib import Path

import aiohttp
import pytest
from fake_proxy import FakeProxy
from robotether_agent.describe_error import UNKNOWN, cause_of, describe_error
from robotether_agent.problems import ServerKeyChangedError, SettingsInvalidError

UNIT = Path(__file__).parents[3] / "agent/systemd/robotether-agent.service"


def test_systemd_does_not_restart_what_a_person_must_look_at():
    line = re.search(r"^RestartPreventExitStatus=(.*)$", UNIT.read_text(), re.MULTILINE)
    codes = {int(code) for code in line[1].split()}
    assert codes == {ServerKeyChangedError.exit_code, SettingsInvalidError.exit_code}


# What no person can use: a class, an object, an address in memory.
FOREIGN = re.compile(r"0x[0-9a-f]|<|\bobject at\b|\w(?:Error|Exception)\b|\.py\b|_ssl|\w\(['\"]")
NASTY = "<aiohttp.Fingerprint object at 0x7f12> ValueError('x') (_ssl.c:1007)"
REQUEST = aiohttp.RequestInfo("http://a", "GET", {}, "http://a")
OF_LIBRARIES = {
    "_os_error": OSError(NASTY),
    "_certificate_error": ssl.SSLCertVerificationError(1, NASTY),
    "status": 0,
    "message": NASTY,
}


def refused_certificate(code):
    error = ssl.SSLCertVerificationError(1, NASTY)
    error.verify_code = code
    return error


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (
            OSError(errno.ETIMEDOUT, "timed out"),
            "the connection fell silent (Connection timed out)",
        ),
        (OSError(errno.EMFILE, "x"), "this program has too many files and connections open"),
        (
            OSError("Multiple exceptions: [Errno 111] ('::1', 1), [Errno 101] ('1.2.3.4', 1)"),
            "Connection refused, or no route leads there (Network is unreachable)",
        ),
        (ssl.SSLError(1, "[SSL: WRONG_VERSION_NUMBER] x"), "does not speak TLS (WRONG_VERSION_NUM"),
        (socket.gaierror(-2, "x"), "no name service knows this name (Name or service not known)"),
        (aiohttp.ClientResponseError(REQUEST, (), status=400), "what it answers is not HTTP"),
        (ValueError("first\nsecond"), UNKNOWN.sentence),
        (refused_certificate(10), "it has expired"),
        (refused_certificate(85), "OpenSSL's strict rules, which Python has from 3.13 on"),
        (refused_certificate(1), "it is refused (no reason)"),
    ],
)
def test_each_reason_is_short_and_on_one_line(error, words):
    """The number of another library is not taken for the system's."""
    assert words in describe_error(error, 4)
    assert "\n" not in describe_error(error, 4)


def subclasses(kind):
    yield kind
    for child in kind.__subclasses__():
        yield from subclasses(child)


def built(kind):
    """Give this exception as its library fills it, with a text that must not get through."""
    numbers = errno.errorcode if issubclass(kind, OSError) else ()
    for arguments in ((NASTY,), *((number, NASTY) for number in numbers)):
        error = kind.__new__(kind, *arguments)
        error.args = arguments
        vars(error).update(OF_LIBRARIES)
        yield error


ROOTS = (aiohttp.ClientError, aiohttp.WebSocketError, OSError, ValueError, EOFError, RuntimeError)
KINDS = sorted(
    {
        kind
        for root in (*ROOTS, asyncio.TimeoutError, MemoryError)
        for kind in subclasses(root)
        if kind.__module__.partition(".")[0] in {"builtins", "ssl", "socket", "asyncio", "aiohttp"}
    },
    key=str,
)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_of_python_stands_in_a_reason(kind):
    """Whatever a library raises: no class, no object, no address and no text of its own reaches a person."""
    for error in built(kind):
        cause = cause_of(error, 4)
        assert cause.sentence
        for text in (cause.sentence, cause.advice):
            assert not FOREIGN.search(text), f"{error!r} is told as {text}"
            assert NASTY not in text


async def test_proxys_password_is_not_told():
    async with FakeProxy("refuses") as proxy, aiohttp.ClientSession() as http:
        url = proxy.url.replace("//", "//ann:s3cret@")
        with pytest.raises(aiohttp.ClientHttpProxyError) as refused:
            await http.get("https://robots.example/", proxy=url)
    assert describe_error(refused.value, 4) == "the HTTP proxy answers 403 Forbidden"
