"""Builds the Flask application, with headers for every answer and for other sites; gunicorn calls start_app."""

import datetime as dt
import logging
import os
import re
import time
from collections.abc import Callable, Collection, Iterable
from typing import TYPE_CHECKING, Any

from flask import Flask, Response, g, request
from prometheus_client import start_http_server
from werkzeug.middleware.proxy_fix import ProxyFix

from robotether_server import api, logs
from robotether_server.api.context import AppContext, csrf
from robotether_server.api.web_metrics import WebMetrics
from robotether_server.backups import RECORD
from robotether_server.db import Database
from robotether_server.db.credentials import Lifetime
from robotether_server.disks import DATABASE_RECORD
from robotether_server.install_line import SiteCertificates
from robotether_server.problems import OriginRefusedError
from robotether_server.services.health import SshProbe
from robotether_server.services.history import Prometheus
from robotether_server.settings.server import WebSettings, load
from robotether_server.tickets import TicketSigner
from robotether_server.web import admin, current_user, errors, forms, page_texts, static_files
from robotether_server.web.pages import (
    button_forms,
    documents,
    drives,
    home,
    installer,
    profile,
    queue_pages,
    recordings,
    robot_settings,
    routes,
)
from robotether_server.web.static_files import CLIENT

if TYPE_CHECKING:
    from wsgiref.types import StartResponse, WSGIEnvironment

log = logging.getLogger(__name__)

MAX_REQUEST_BYTES = 64 * 1024
# Port of the numbers for Prometheus, inside the stack alone.
METRICS_PORT = 9102

# Characters allowed in a policy, as a client writes the Host header.
HOST = re.compile(r"[A-Za-z0-9.-]+(:[0-9]+)?|\[[0-9A-Fa-f:.]+\](:[0-9]+)?")
# A joystick drives and the video fills the screen; nothing else of the operator's device is of use here.
PERMISSIONS_POLICY = ", ".join(
    (
        "gamepad=(self)",
        "fullscreen=(self)",
        *(
            f"{feature}=()"
            for feature in (
                "accelerometer",
                "camera",
                "display-capture",
                "geolocation",
                "gyroscope",
                "hid",
                "magnetometer",
                "microphone",
                "midi",
                "payment",
                "serial",
                "usb",
            )
        ),
    )
)

# What pages of ALLOWED_ORIGINS need to drive, with an API token. The relay does the same for control and video.
CORS_PATHS = frozenset(("/api/v1/tickets", "/api/v1/tickets/app", "/api/v1/robots"))
CORS_METHODS = "GET, POST"
CORS_HEADERS = "Authorization, Content-Type"
PREFLIGHT_CACHE_S = 600
# Number of database connections kept for the next requests; the account has few for all cells.
KEPT_CONNECTIONS = 4


def create_app(settings: WebSettings) -> Flask:
    """Return the application; it opens no connection before the first request."""
    app = Flask("robotether_server.web")
    app.config.update(
        SECRET_KEY=settings.secret_key,
        MAX_CONTENT_LENGTH=MAX_REQUEST_BYTES,
        SESSION_COOKIE_NAME="__Host-robotether_forms",
        SESSION_COOKIE_SECURE=True,
        SESSION_COOKIE_HTTPONLY=True,
        SESSION_COOKIE_SAMESITE="Lax",
        # A drive page may stay open for longer than any fixed time.
        WTF_CSRF_TIME_LIMIT=None,
        # Some browsers are configured to send no Referer; the token and SameSite do not need it.
        WTF_CSRF_SSL_STRICT=False,
    )
    # nginx is the one proxy in front. It sets these two itself and passes Host on; it sets no
    # X-Forwarded-Host, so believing one would let clients choose it.
    app.wsgi_app = ProxyFix(app.wsgi_app, x_for=1, x_proto=1, x_host=0)  # type: ignore[method-assign] # Flask's documented way
    app.extensions["robotether"] = make_context(settings)
    _count_requests(app, logs.RequestLog(log, settings.log_format))
    csrf.init_app(app)
    csrf.exempt(api.blueprint)
    errors.register(app)
    app.after_request(_add_headers)
    _register_cors(app, settings.allowed_origins)
    static_files.register(app)
    page_texts.register(app)
    forms.register(app)
    current_user.register(app)
    app.register_blueprint(home.blueprint)
    app.register_blueprint(api.blueprint)
    app.register_blueprint(installer.blueprint)
    app.register_blueprint(documents.blueprint)
    app.register_blueprint(admin.blueprint)
    app.register_blueprint(profile.blueprint)
    app.register_blueprint(drives.blueprint)
    app.register_blueprint(queue_pages.blueprint)
    app.register_blueprint(recordings.blueprint)
    app.register_blueprint(routes.blueprint)
    app.register_blueprint(robot_settings.blueprint)
    app.register_blueprint(button_forms.blueprint)
    return app


def make_context(settings: WebSettings) -> AppContext:
    """Return what the request handlers share."""
    database = Database(settings.database, keep=KEPT_CONNECTIONS)
    certificates = SiteCertificates(settings.site_address)
    return AppContext(
        database=database,
        signer=TicketSigner(settings.tickets.key, settings.tickets.ttl_s),
        join=settings.join,
        site_certificates=certificates,
        agent_files_dir=settings.agent_files_dir,
        login_lifetime=Lifetime(
            dt.timedelta(hours=settings.login_ttl_h), dt.timedelta(hours=settings.login_idle_h)
        ),
        wall_robots=settings.wall_robots,
        backup_record=RECORD,
        database_record=DATABASE_RECORD,
        metrics=WebMetrics(database, certificates),
        ssh_probe=SshProbe(settings.site_address.tls_front),
        prometheus=Prometheus(settings.prometheus),
    )


def make_app() -> Flask:
    """Read the environment, and return the application."""
    loaded = load(WebSettings, os.environ)
    logs.set_up(loaded.log_level, loaded.log_format)
    return create_app(loaded)


def start_app() -> Flask:
    """Return the application, and serve its numbers: for gunicorn, started by `robotether web`."""
    app = make_app()
    metrics: WebMetrics = app.extensions["robotether"].metrics
    start_http_server(METRICS_PORT, registry=metrics.registry)
    return app


def _count_requests(app: Flask, request_log: logs.RequestLog) -> None:
    """Count all answers, and how long each took, and log them.

    Around Flask, which gives some answers before it asks anybody.
    """
    serve = app.wsgi_app

    def measured(environ: "WSGIEnvironment", start_response: "StartResponse") -> Iterable[bytes]:
        began_s = time.perf_counter()
        logs.set_request_id(environ.get("HTTP_X_REQUEST_ID"))

        def start(status: str, *arguments: Any) -> Callable[[bytes], object]:
            metrics: WebMetrics = app.extensions["robotether"].metrics
            took_s, number = time.perf_counter() - began_s, int(status[:3])
            metrics.count_request(number, took_s)
            path = environ["PATH_INFO"].encode("latin-1").decode(errors="replace")
            request_log.write(environ["REQUEST_METHOD"], path, number, took_s)
            return start_response(status, *arguments)

        return serve(environ, start)

    app.wsgi_app = measured  # type: ignore[method-assign] # as above


def _add_headers(response: Response) -> Response:
    """Add the security headers of every answer."""
    # The documents have a policy of their own.
    policy = content_security_policy(request.host, g.get("other_machines", ()))
    response.headers.setdefault("Content-Security-Policy", policy)
    response.headers["Cross-Origin-Opener-Policy"] = "same-origin"
    response.headers["Permissions-Policy"] = PERMISSIONS_POLICY
    response.headers["Referrer-Policy"] = "same-origin"
    response.headers["X-Content-Type-Options"] = "nosniff"
    response.headers["X-Frame-Options"] = "DENY"
    # What depends on who asks must not come out of a cache for the next person.
    response.headers.setdefault("Cache-Control", "no-store")
    return response


def content_security_policy(host: str, others: Iterable[str] = ()) -> str:
    """Return the policy of a page of this host, `NAME[:PORT]`; it may ask `others`, written alike, too."""
    # Beside 'self', because some browsers do not count wss://same-host as 'self'.
    sockets = f" wss://{host}" if HOST.fullmatch(host) else ""
    origins = "".join(f" https://{other}" for other in others if HOST.fullmatch(other))
    return "; ".join(
        (
            "default-src 'self'",
            "img-src 'self' blob: data:",
            f"connect-src 'self'{sockets}{origins}",
            "object-src 'none'",
            "base-uri 'none'",
            "form-action 'self'",
            "frame-ancestors 'none'",
        )
    )


def _register_cors(app: Flask, allowed_origins: Collection[str]) -> None:
    """Answer browsers that ask whether a page of another site may, and mark what it may read.

    No answer allows credentials, so their browsers never use a login.
    """
    allowed = frozenset(allowed_origins)

    @app.before_request
    def preflight() -> Response | None:
        return _answer_preflight(allowed) if _is_preflight() else None

    @app.after_request
    def mark(response: Response) -> Response:
        if request.path in CORS_PATHS:
            _mark_readable(response, allowed)
        elif request.path == CLIENT:
            # The same for everybody, and no secret: any page may load it.
            response.headers["Access-Control-Allow-Origin"] = "*"
        return response


def _is_preflight() -> bool:
    asks = "Access-Control-Request-Method" in request.headers
    return request.method == "OPTIONS" and asks and request.path in CORS_PATHS


def _answer_preflight(allowed: frozenset[str]) -> Response:
    origin = request.headers.get("Origin", "")
    if origin not in allowed:
        raise OriginRefusedError(
            f"cannot serve a page of {origin[:100]!r}: it is not in ALLOWED_ORIGINS"
        )
    response = Response(status=204)
    response.headers["Access-Control-Allow-Methods"] = CORS_METHODS
    response.headers["Access-Control-Allow-Headers"] = CORS_HEADERS
    response.headers["Access-Control-Max-Age"] = str(PREFLIGHT_CACHE_S)
    return response


def _mark_readable(response: Response, allowed: frozenset[str]) -> None:
    # Also where there is none: a cache must not give its answer to a page of another site.
    response.vary.add("Origin")
    origin = request.headers.get("Origin")
    if origin is not None and origin in allowed:
        response.headers["Access-Control-Allow-Origin"] = origin
