"""Turns problems into answers: JSON (RFC 9457) under /api and /static, a page elsewhere.

The border of a request: an unexpected exception is logged here with its traceback, and answered with 500.
"""

import logging
from http import HTTPStatus

from flask import Flask, Response, g, json, make_response, render_template, request
from flask_wtf.csrf import CSRFError  # type: ignore[import-untyped] # it has no types
from werkzeug.exceptions import BadHost, HTTPException, MethodNotAllowed

from robotether_server.api import auth
from robotether_server.api.context import context
from robotether_server.problems import (
    PROBLEM_JSON,
    CsrfRefusedError,
    HttpError,
    LoginMissingError,
    RobotetherError,
    StoreError,
    StoreUnavailableError,
    ThrottledError,
)
from robotether_server.web import current_user, forms

logger = logging.getLogger(__name__)

# nginx compresses /static: the length of a page there would reveal its content (BREACH).
JSON_PATHS = ("/api/", "/static/")
API_PATH = "/api/v1/"


def register(app: Flask) -> None:
    """Answer every kind of failure of the application."""
    app.register_error_handler(RobotetherError, answer)
    app.register_error_handler(CSRFError, _answer_csrf)
    app.register_error_handler(HTTPException, _answer_http)
    app.register_error_handler(Exception, _answer_unforeseen)


def answer(problem: RobotetherError) -> Response:
    """Return the response for a problem."""
    if isinstance(problem, StoreUnavailableError):
        logger.error("%s: %s", problem.detail, problem.__cause__)
    response = _as_json(problem) if request.path.startswith(JSON_PATHS) else _as_page(problem)
    response.status_code = problem.status
    if problem.status == HTTPStatus.UNAUTHORIZED and request.path.startswith(API_PATH):
        response.headers["WWW-Authenticate"] = "Bearer"  # RFC 9110, as the relay does
    if isinstance(problem, ThrottledError):
        response.headers["Retry-After"] = str(problem.retry_after_s)
    return response


def _as_json(problem: RobotetherError) -> Response:
    return Response(json.dumps(problem.as_dict()), content_type=PROBLEM_JSON)


def _as_page(problem: RobotetherError) -> Response:
    if isinstance(problem, LoginMissingError) and request.method == "POST":
        page = render_template("login.html", onward=request.path, kept=forms.keep(), ended=problem)
        return make_response(page)
    if problem.status < HTTPStatus.INTERNAL_SERVER_ERROR:
        _keep_menu()
    title = HTTPStatus(problem.status).phrase.capitalize()
    # Never a form without a valid token: whoever sends it again would do what another site has filled in.
    keeps = isinstance(problem, StoreUnavailableError) and request.method == "POST"
    page = render_template(
        "problem.html",
        status=int(problem.status),
        title=title,
        detail=problem.detail,
        kept=forms.keep() if keeps else None,
    )
    return make_response(page)


def _keep_menu() -> None:
    """Find the user of a page that failed before it asked who that is."""
    if "user" in g:
        return
    try:
        with context().database.transaction() as tx:
            user = auth.page_user(tx, request)
            if user is not None:
                current_user.remember(tx, user)
    except StoreError:
        logger.warning("cannot show the menu on an error page", exc_info=True)


def _answer_csrf(error: CSRFError) -> Response:
    return answer(
        CsrfRefusedError(
            f"cannot accept the form: {error.description} Load the page again, and send it once more."
        )
    )


def _answer_http(error: HTTPException) -> Response:
    # Redirects are HTTPExceptions too; and where the header Host is none, a page would have no links.
    if error.code is None or error.code < HTTPStatus.BAD_REQUEST or isinstance(error, BadHost):
        return Response(error.get_body(), error.code, error.get_headers())
    detail = error.description or "there are no details"
    if error.code == HTTPStatus.NOT_FOUND:
        detail = "There is no page at this address."
        if request.path.startswith(API_PATH):
            detail = f"cannot find this address: GET {API_PATH}openapi.json lists all"
    if isinstance(error, MethodNotAllowed) and error.valid_methods:
        detail = f"cannot use {request.method}: send {' or '.join(sorted(error.valid_methods))}"
    response = answer(HttpError(error.code, detail))
    for name, value in error.get_headers():
        if name.lower() not in {"content-type", "content-length"}:
            response.headers[name] = value
    return response


def _answer_unforeseen(error: Exception) -> Response:
    # The path comes from outside, and must not write a line of its own.
    logger.error("cannot answer %s %r", request.method, request.path, exc_info=error)
    status = HTTPStatus.INTERNAL_SERVER_ERROR
    return answer(HttpError(status, "cannot answer: an error in the server; see its log"))
