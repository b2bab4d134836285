"""Describes in a few words why something on the network did not answer; for health probes and the doctor."""

from __future__ import annotations

import asyncio
import os
import socket
import ssl

import aiohttp

from robotether_agent.fields import printable


def describe_error(error: BaseException, timeout_s: float) -> str:
    """Return the reason in `error`; `timeout_s` is how long was waited, if that is the reason."""
    if isinstance(error, asyncio.TimeoutError):
        return f"no answer in {timeout_s:g} s"
    if isinstance(error, aiohttp.WSServerHandshakeError):
        return f"it answers with HTTP status {error.status}, not with a WebSocket"
    if isinstance(error, aiohttp.ClientHttpProxyError):
        # Its own text has the proxy's password.
        return printable(f"the HTTP proxy answers {error.status} {error.message}", 200)
    number = error.os_error.errno if isinstance(error, aiohttp.ClientConnectorError) else None
    # In the errors of TLS and of names the number is another library's.
    if isinstance(error, OSError) and not isinstance(error, ssl.SSLError | socket.gaierror):
        number = number or error.errno
    # asyncio's and aiohttp's own texts repeat the address.
    if number is not None and number > 0:
        return os.strerror(number)
    return printable(str(error) or type(error).__name__, 200)
