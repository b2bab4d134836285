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
    error = _cause(error)
    # In the errors of TLS and of names the number is another library's.
    is_systems = not isinstance(error, ssl.SSLError | socket.gaierror)
    if isinstance(error, OSError) and is_systems and error.errno is not None and error.errno > 0:
        # asyncio's own text repeats the address.
        return os.strerror(error.errno)
    return printable(str(error) or type(error).__name__, 200)


def _cause(error: BaseException) -> BaseException:
    """Return what aiohttp's error wraps: its own text repeats the address, and shows Python's objects."""
    if isinstance(error, aiohttp.ClientConnectorCertificateError):
        return error.certificate_error
    return error.os_error if isinstance(error, aiohttp.ClientConnectorError) else error
