"""Why something did not answer, in words that a person can use."""

from __future__ import annotations

import asyncio
import errno
import socket
import ssl

import aiohttp
import pytest
from aiohttp.client_reqrep import ConnectionKey
from fake_proxy import FakeProxy
from robotether_agent.describe_error import describe_error


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (asyncio.TimeoutError(), "no answer in 4 s"),
        (OSError(errno.ECONNREFUSED, "Connect call failed ('127.0.0.1', 1)"), "Connection refused"),
        (ssl.SSLError(1, "[SSL: WRONG_VERSION_NUMBER]"), "WRONG_VERSION_NUMBER"),
        (socket.gaierror(-2, "Name or service not known"), "Name or service not known"),
        (ValueError("first\nsecond"), "first second"),
        (ValueError(), "ValueError"),
    ],
)
def test_each_reason_is_short_and_on_one_line(error, told):
    """The number of another library is not taken for the system's."""
    assert told in describe_error(error, 4)
    assert "\n" not in describe_error(error, 4)


@pytest.mark.parametrize(
    ("cause", "told"),
    [
        (ssl.SSLError(1, "[SSL: WRONG_VERSION_NUMBER]"), "WRONG_VERSION_NUMBER"),
        (socket.gaierror(-2, "Name or service not known"), "Name or service not known"),
        (OSError(errno.ENETUNREACH, "Connect call failed"), "Network is unreachable"),
    ],
)
def test_no_object_of_python_stands_in_a_reason(cause, told):
    """The text of aiohttp's error has the address of the pinned fingerprint's object."""
    pinned = aiohttp.Fingerprint(bytes(32))
    key = ConnectionKey("robots.example", 443, True, pinned, None, None, None)
    reason = describe_error(aiohttp.ClientConnectorError(key, cause), 4)
    assert told in reason
    assert "Fingerprint" not in reason
    assert "0x" not in reason


def test_an_untrusted_certificate_is_named_by_its_cause():
    """The error of aiohttp for it has no `os_error`."""
    key = ConnectionKey("robots.example", 443, True, True, None, None, None)
    error = aiohttp.ClientConnectorCertificateError(
        key, ssl.SSLCertVerificationError(1, "self-signed")
    )
    assert describe_error(error, 4).endswith("self-signed")


async def test_proxys_password_is_not_told():
    """The text of aiohttp has the proxy's URL."""
    async with FakeProxy("refuses") as proxy, aiohttp.ClientSession() as http:
        url = proxy.url.replace("//", "//ann:s3cret@")
        with pytest.raises(aiohttp.ClientHttpProxyError) as refused:
            await http.get("https://robots.example/", proxy=url)
    assert describe_error(refused.value, 4) == "the HTTP proxy answers 403 Forbidden"
