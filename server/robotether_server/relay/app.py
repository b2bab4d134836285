"""The relay's HTTP applications: the public routes behind nginx, the same for other cells, and the inside ones.

`wiring` makes both. The middleware is the border at which a RobotetherError becomes an answer.
"""

from __future__ import annotations

import asyncio
import logging
import re
import time
from collections.abc import Awaitable, Callable, Collection, Iterable

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError
from aiohttp.typedefs import Middleware

from robotether_server.logs import REQUEST_ID_HEADER, RequestLog, set_request_id
from robotether_server.problems import (
    PROBLEM_JSON,
    HttpError,
    OriginRefusedError,
    RobotetherError,
    ThrottledError,
)
from robotether_server.relay.cells.forwarding import Forwarding
from robotether_server.relay.cells.keys import PROOF_HEADER, PeerKeys
from robotether_server.relay.metrics import Metrics
from robotether_server.relay.records.fleet import Fleet
from robotether_server.settings.server import RelaySettings

log = logging.getLogger(__name__)
# For aiohttp's server, in place of its own.
server_log = logging.getLogger(f"{__name__}.server")

# Maximum size of a body: a reason, a site or an action.
MAX_BODY_BYTES = 4096
# Maximum size of a request's first line and of a header: more than nginx, which has the limits, lets through.
MAX_LINE_BYTES = 16_384
# Time limit for the handlers when the relay stops.
HANDLERS_STOP_WITHIN_S = 1.0

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

# What pages in ALLOWED_ORIGINS may ask for, with a token or ticket: control, ROS and video.
CORS_PATHS = re.compile(
    r"/api/v1/robots/[^/]+/(stop|release|lease|control|(topics|services)/.+)|/robots/[^/]+/video(/.*)?"
)
CORS_METHODS = "GET, HEAD, POST"
CORS_HEADERS = "Authorization, Content-Type"
PREFLIGHT_KEPT_S = 600


class WithoutRequest(logging.Filter):
    """Keeps a request that cannot be parsed out of the log: its line may hold a ticket, its headers a login."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Leave what kind of error it was."""
        error = record.exc_info[1] if record.exc_info else None
        if isinstance(error, HttpProcessingError):
            record.msg, record.args = f"{record.getMessage()}: {type(error).__name__}", ()
            record.exc_info = record.exc_text = None
        return True


server_log.addFilter(WithoutRequest())


def public_app(
    settings: RelaySettings,
    metrics: Metrics,
    routes: Iterable[web.RouteDef],
    forwarding: Forwarding | None = None,
) -> web.Application:
    """Make the application that nginx hands requests to; without `forwarding` all are answered here."""
    cors = Cors(settings.allowed_origins)

    @web.middleware
    async def answer_problems(request: web.Request, handler: Handler) -> web.StreamResponse:
        try:
            if (preflight := cors.preflight(request)) is not None:
                return preflight
            if (
                forwarding is not None
                and (forwarded := await forwarding.answer(request)) is not None
            ):
                return forwarded
            return await handler(request)
        except RobotetherError as problem:
            metrics.refusals.labels(problem.code).inc()
            # Paths and details hold what came from outside, which must not write a line of its own.
            log.info(
                "%r refused: %s: %r",
                request.path[:200],
                problem.code,
                problem.detail,
                # By design no request ends so.
                exc_info=problem.code == RobotetherError.code,
            )
            return problem_answer(problem)
        except web.HTTPException as exc:
            answer = problem_answer(_refusal(request, exc))
            if "Allow" in exc.headers:
                answer.headers["Allow"] = exc.headers["Allow"]
            return answer
        except Exception:
            log.exception("%r failed", request.path[:200])
            return problem_answer(HttpError(500, "cannot answer: see the log of the relay"))

    app = web.Application(
        middlewares=[_logger(RequestLog(log, settings.log_format)), answer_problems],
        client_max_size=MAX_BODY_BYTES,
    )
    app.add_routes(routes)
    app.on_response_prepare.append(cors.mark)
    return app


def _refusal(request: web.Request, refusal: web.HTTPException) -> HttpError:
    """Return why aiohttp refuses a request, and what it would take."""
    what = f"cannot serve {request.path[:200]}"
    if isinstance(refusal, web.HTTPMethodNotAllowed):
        what += f": send {' or '.join(sorted(refusal.allowed_methods))}, not {request.method[:20]}"
    elif isinstance(refusal, web.HTTPRequestEntityTooLarge):
        what += f": {refusal.text}"
    return HttpError(refusal.status, what)


def _logger(request_log: RequestLog) -> Middleware:
    @web.middleware
    async def log_request(request: web.Request, handler: Handler) -> web.StreamResponse:
        """Log it when it is over; a WebSocket's end is its connection's."""
        began_s = time.monotonic()
        set_request_id(request.headers.get(REQUEST_ID_HEADER))
        status = 499  # as nginx has it where the client has gone
        try:
            response = await handler(request)
            status = response.status
            return response
        finally:
            request_log.write(request.method, request.path, status, time.monotonic() - began_s)

    return log_request


def peer_app(
    app: web.Application, keys: PeerKeys, routes: Iterable[web.RouteDef]
) -> web.Application:
    """Make of a public one the application for other cells, whose requests nginx's peer listener passes on."""

    @web.middleware
    async def check_proof(request: web.Request, handler: Handler) -> web.StreamResponse:
        # Anybody else could name a client's address in X-Forwarded-For, and see the whole fleet.
        if not keys.is_proof(request.headers.get(PROOF_HEADER, "")):
            return problem_answer(HttpError(403, "cannot serve the request: no cell sent it"))
        return await handler(request)

    app.middlewares.insert(0, check_proof)
    app.add_routes(routes)
    return app


def inside_app(
    fleet: Fleet, cells: Callable[[], Iterable[str]], routes: Iterable[web.RouteDef]
) -> web.Application:
    """Make the application for health checks, nginx's list of `cells`, and further routes inside the stack."""

    async def healthz(_request: web.Request) -> web.Response:
        # A database that is away is no reason to restart the relay: what is open goes on.
        return web.json_response({"status": "ok", "store": "up" if fleet.store_up else "down"})

    @web.middleware
    async def answer_problems(request: web.Request, handler: Handler) -> web.StreamResponse:
        try:
            return await handler(request)
        except RobotetherError as problem:
            return problem_answer(problem)

    async def list_cells(_request: web.Request) -> web.Response:
        return web.Response(text="".join(f"{address}\n" for address in cells()))

    app = web.Application(middlewares=[answer_problems])
    app.add_routes([web.get("/healthz", healthz), web.get("/cells", list_cells), *routes])
    return app


class Servers:
    """The HTTP servers of a relay, one for each application."""

    def __init__(self, host: str, backlog: int) -> None:
        self._host = host
        self._backlog = backlog
        self._runners: list[web.AppRunner] = []

    async def serve(self, app: web.Application, port: int) -> int:
        """Listen; port 0 is any that is free. Return the port."""
        runner = web.AppRunner(
            app,
            access_log=None,
            logger=server_log,
            handler_cancellation=True,
            shutdown_timeout=HANDLERS_STOP_WITHIN_S,
            max_line_size=MAX_LINE_BYTES,
            max_field_size=MAX_LINE_BYTES,
            # A body that is not packed as its header says would fail a stop, which needs none.
            auto_decompress=False,
        )
        await runner.setup()
        self._runners.append(runner)
        await web.TCPSite(runner, self._host, port, backlog=self._backlog).start()
        return int(runner.addresses[0][1])

    async def close(self) -> None:
        """Listen no more, and end what is open."""
        await asyncio.gather(*(runner.cleanup() for runner in self._runners))


def problem_answer(problem: RobotetherError) -> web.Response:
    """Write a problem as RFC 9457 says."""
    headers = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff"}
    if problem.status == 401:  # noqa: PLR2004  # RFC 9110 wants the header with this status
        headers["WWW-Authenticate"] = "Bearer"
    if isinstance(problem, ThrottledError):
        headers["Retry-After"] = str(problem.retry_after_s)
    return web.json_response(
        problem.as_dict(), status=problem.status, headers=headers, content_type=PROBLEM_JSON
    )


class Cors:
    """Lets pages in ALLOWED_ORIGINS read the answers for CORS_PATHS.

    A login is never shown from there: no answer allows credentials.
    """

    def __init__(self, allowed_origins: Collection[str]) -> None:
        self._allowed = frozenset(allowed_origins)

    def preflight(self, request: web.Request) -> web.Response | None:
        """Answer a browser that asks whether a page may; None: it asks for something else."""
        if request.method != "OPTIONS" or not CORS_PATHS.fullmatch(request.path):
            return None
        if "Access-Control-Request-Method" not in request.headers:
            return None
        origin = request.headers.get("Origin", "")
        if origin not in self._allowed:
            raise OriginRefusedError(
                f"cannot serve a page of {origin[:100]!r}: it is not in ALLOWED_ORIGINS"
            )
        headers = {
            "Access-Control-Allow-Methods": CORS_METHODS,
            "Access-Control-Allow-Headers": CORS_HEADERS,
            "Access-Control-Max-Age": str(PREFLIGHT_KEPT_S),
        }
        return web.Response(status=204, headers=headers)

    async def mark(self, request: web.Request, response: web.StreamResponse) -> None:
        """Let the page read the answer; aiohttp calls this before an answer's headers go out."""
        if not CORS_PATHS.fullmatch(request.path):
            return
        response.headers.add("Vary", "Origin")
        origin = request.headers.get("Origin")
        if origin is not None and origin in self._allowed:
            response.headers["Access-Control-Allow-Origin"] = origin
