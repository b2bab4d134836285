"""Keeps the relay's HTTP client from going where a robot sends it.

aiohttp follows redirects when it opens a WebSocket, and has no setting against that. A robot whose
key was stolen could so lead the connection of its own driver to another robot's port, or anywhere
else on the relay's networks. `relay` puts this into the client that it makes towards robots.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import NoReturn

from aiohttp import ClientError, ClientSession, TraceConfig, TraceRequestRedirectParams


class RedirectedError(ClientError):
    """A robot answered with a redirect."""


def refuse_redirects() -> TraceConfig:
    """Return what makes a client raise RedirectedError in place of following a redirect."""
    trace = TraceConfig()
    trace.on_request_redirect.append(_refuse)
    return trace


async def _refuse(
    _client: ClientSession, _context: SimpleNamespace, redirect: TraceRequestRedirectParams
) -> NoReturn:
    # Before anything else is done with it: the connection must not stay open in the pool.
    redirect.response.close()
    raise RedirectedError("it answered with a redirect, which is not followed")
