"""Lets pages of other sites read what driving needs: a ticket, the list of robots, our client module.

The pages of ALLOWED_ORIGINS, which send an API token. No answer allows credentials, so their
browsers never use a login. The relay does the same for control and video (relay/app.py).
"""

from collections.abc import Collection

from flask import Flask, Response, request

from robotether_server.problems import OriginRefused

PATHS = frozenset(("/api/v1/tickets", "/api/v1/robots"))
METHODS = "GET, POST"
HEADERS = "Authorization, Content-Type"
PREFLIGHT_CACHE_S = 600
# The same for everybody, and no secret: any page may load it. Kept so shortly that an upgrade reaches all pages.
CLIENT = "/static/dist/robotether-client.js"
CLIENT_CACHE_S = 300


def register(app: Flask, allowed_origins: Collection[str]) -> None:
    """Answer browsers that ask whether a page may, and mark what a page may read."""
    allowed = frozenset(allowed_origins)

    @app.before_request
    def preflight() -> Response | None:
        return _preflight(allowed) if _is_preflight() else None

    @app.after_request
    def mark(response: Response) -> Response:
        if request.path in PATHS:
            _mark(response, allowed)
        elif request.path == CLIENT:
            response.headers["Access-Control-Allow-Origin"] = "*"
            response.headers["Cache-Control"] = f"public, max-age={CLIENT_CACHE_S}"
        return response


def _is_preflight() -> bool:
    asks = "Access-Control-Request-Method" in request.headers
    return request.method == "OPTIONS" and asks and request.path in PATHS


def _preflight(allowed: frozenset[str]) -> Response:
    origin = request.headers.get("Origin", "")
    if origin not in allowed:
        raise OriginRefused(
            f"cannot serve a page of {origin[:100]!r}: it is not in ALLOWED_ORIGINS"
        )
    response = Response(status=204)
    response.headers["Access-Control-Allow-Methods"] = METHODS
    response.headers["Access-Control-Allow-Headers"] = HEADERS
    response.headers["Access-Control-Max-Age"] = str(PREFLIGHT_CACHE_S)
    return response


def _mark(response: Response, allowed: frozenset[str]) -> None:
    # Also where there is none: a cache must not give its answer to a page of another site.
    response.vary.add("Origin")
    origin = request.headers.get("Origin")
    if origin is not None and origin in allowed:
        response.headers["Access-Control-Allow-Origin"] = origin
