"""Lets pages in ALLOWED_ORIGINS read what they may ask for with a token or ticket: control and video.

`app` asks here before a handler and before each answer goes out. A login is never shown from there: no
answer allows credentials.
"""

from __future__ import annotations

import re
from collections.abc import Collection

from aiohttp import web

from robotether_server.problems import OriginRefused

PATHS = re.compile(r"/api/v1/robots/[^/]+/(stop|release|lease|control)|/robots/[^/]+/video(/.*)?")
METHODS = "GET, HEAD, POST"
HEADERS = "Authorization, Content-Type"
KEPT_S = 600


class Cors:
    """The answers to pages of other sites."""

    def __init__(self, allowed_origins: Collection[str]) -> None:
        self._allowed = frozenset(allowed_origins)

    def preflight(self, request: web.Request) -> web.Response | None:
        """Answer a browser that asks whether a page may; None: it asks for something else."""
        if request.method != "OPTIONS" or not PATHS.fullmatch(request.path):
            return None
        if "Access-Control-Request-Method" not in request.headers:
            return None
        origin = request.headers.get("Origin", "")
        if origin not in self._allowed:
            raise OriginRefused(
                f"cannot serve a page of {origin[:100]!r}: it is not in ALLOWED_ORIGINS"
            )
        headers = {
            "Access-Control-Allow-Methods": METHODS,
            "Access-Control-Allow-Headers": HEADERS,
            "Access-Control-Max-Age": str(KEPT_S),
        }
        return web.Response(status=204, headers=headers)

    async def mark(self, request: web.Request, response: web.StreamResponse) -> None:
        """Let the page read the answer; aiohttp calls this before an answer's headers go out."""
        if not PATHS.fullmatch(request.path):
            return
        response.headers.add("Vary", "Origin")
        origin = request.headers.get("Origin")
        if origin is not None and origin in self._allowed:
            response.headers["Access-Control-Allow-Origin"] = origin
