"""Finds the caller: a browser with a login, or a program with an API token.

Used by every handler that needs a user. Reveals nothing about logins and tokens that are not valid. A handler of the
API does a whole request in one transaction, in which `admit` is the first: a failure undoes all of it,
the audit event included.
"""

from dataclasses import dataclass
from typing import Literal

from flask import Request, request
from werkzeug.wrappers import Response

from robotether_server.api.context import context, csrf
from robotether_server.api.recent_users import RecentUser
from robotether_server.db import Transaction, credentials, seen_robots
from robotether_server.db.audit import Source
from robotether_server.db.users import User
from robotether_server.problems import (
    GrantMissingError,
    LoginMissingError,
    TokenInvalidError,
    UnauthorizedError,
)
from robotether_server.services import joining
from robotether_server.services.joining import EnrolmentCredential
from robotether_server.tickets import CredentialKind

COOKIE = "__Host-robotether_login"
SCHEME = "bearer "
# Who may call. `manager`: of the robot in the path. `enroller`: also a join token. `metrics`: an
# admin, also by a token that is for metrics alone.
Who = Literal["admin", "manager", "user", "enroller", "metrics", "anybody"]
OF_ADMINS: tuple[Who, ...] = ("admin", "metrics")


def page_user(tx: Transaction, request: Request, *, renew: bool = True) -> User | None:
    """Return the user of the request's login, if it is valid; with `renew` the login counts as used now."""
    text = request.cookies.get(COOKIE)
    user = credentials.find_login_user(tx, text) if text else None
    if renew and text and user is not None:
        _renew(tx, text)
    return user


def _renew(tx: Transaction, text: str) -> None:
    ends_at = credentials.login_renewal(tx, text, context().login_lifetime)
    if ends_at is not None:
        # On its own: what the request does may fail, or keep its transaction open for long.
        with context().database.transaction() as own:
            credentials.renew_login(own, text, ends_at)


def api_user(tx: Transaction, request: Request, *, renew: bool = True) -> User:
    """Return the user of a Bearer token, else of a login as in `page_user`.

    Raises LoginMissingError or TokenInvalidError.

    An invalid token is refused even beside a valid login, so that the program that sent it
    notices. A change by a login needs the page's token in X-CSRFToken, as any other site could
    make the browser send the cookie.
    """
    try:
        user = credential_user(tx, request, renew=renew)
    except UnauthorizedError:
        context().recent_users.forget(credential_of(request))
        raise
    context().recent_users.note(credential_of(request), RecentUser(user.id, user.name))
    protect_login(request)
    return user


def credential_user(tx: Transaction, request: Request, *, renew: bool) -> User:
    """Return the user of a Bearer token, else of a login; raise LoginMissingError or TokenInvalidError."""
    header = request.headers.get("Authorization")
    if header is not None:
        return credentials.get_token_user(tx, _bearer(header))
    user = page_user(tx, request, renew=renew)
    if user is None:
        raise LoginMissingError(
            "cannot identify the caller: log in, or send an API token as Bearer"
        )
    return user


def _metrics_user(tx: Transaction, request: Request) -> User:
    """Return the user of a token that is for the metrics alone, else that of `api_user`."""
    header = request.headers.get("Authorization")
    # Not remembered as a recent user, who gets tickets while the database is away.
    user = None if header is None else credentials.find_token_user(tx, _bearer(header), "metrics")
    return user or api_user(tx, request, renew=False)


def protect_login(request: Request) -> None:
    """Refuse a change by a login that does not come from a page of this site."""
    if "Authorization" not in request.headers:
        csrf.protect()


def enrolment_credential(tx: Transaction, request: Request) -> EnrolmentCredential:
    """Return the enrolment credential: a join token, or an API token or login of an admin.

    Raises LoginMissingError, TokenInvalidError, TokenExpiredError or GrantMissingError.
    """
    header = request.headers.get("Authorization")
    if header is not None:
        return joining.find_credential(tx, _bearer(header))
    return joining.credential_of_admin(api_user(tx, request))


def credential_of(request: Request) -> tuple[CredentialKind, str]:
    """Return the kind and the SHA-256, in hex, of the credential that `api_user` accepts."""
    header = request.headers.get("Authorization")
    if header is not None:
        return "token", credentials.digest(_bearer(header)).hex()
    return "login", credentials.digest(request.cookies.get(COOKIE, "")).hex()


def _bearer(header: str) -> str:
    if header[: len(SCHEME)].lower() != SCHEME:
        raise TokenInvalidError(
            "cannot accept the header Authorization: it must be 'Bearer rt_...'"
        )
    return header[len(SCHEME) :].strip()


def set_login(response: Response, text: str) -> None:
    """Give the browser its login."""
    lifetime = context().login_lifetime.total
    response.set_cookie(COOKIE, text, max_age=lifetime, secure=True, httponly=True, samesite="Lax")


def clear_login(response: Response) -> None:
    """Delete the browser's login."""
    response.delete_cookie(COOKIE, secure=True, httponly=True, samesite="Lax")


@dataclass(frozen=True)
class Caller:
    """A user with an open transaction; `source` is how the user signs the audit log."""

    tx: Transaction
    user: User
    source: Source


@dataclass(frozen=True)
class EnrolmentCaller:
    """The caller that enrols a robot, with an open transaction."""

    tx: Transaction
    credential: EnrolmentCredential
    source: Source


def admit(tx: Transaction, who: Who, robot: str, *, renew: bool = True) -> Caller | EnrolmentCaller:
    """Admit the caller of an operation, or raise what `api_user` or `enrolment_credential` raises.

    Raises GrantMissingError for a user who is not an admin and does not manage the robot, which reveals nothing;
    a robot that the user may not see, or that has not the `mac` of the query, is RobotUnknownError. Without `renew` the
    login does not count as used.
    """
    if who == "enroller":
        credential = enrolment_credential(tx, request)
        source = Source(credential.actor, request.remote_addr)
        return EnrolmentCaller(tx, credential, source)
    user = _metrics_user(tx, request) if who == "metrics" else api_user(tx, request, renew=renew)
    if who in OF_ADMINS:
        check_admin(user)
    mac = request.args.get("mac")
    if who == "manager":
        seen_robots.require(tx, user, robot, "manage", mac=mac)
    elif robot and mac is not None:
        seen_robots.require(tx, user, robot, "observe", "open", mac=mac)
    return Caller(tx, user, _source_of(user))


def _source_of(user: User) -> Source:
    kind, sha256 = credential_of(request)
    api_token = bytes.fromhex(sha256) if kind == "token" else None
    return Source(user.name, request.remote_addr, api_token)


def check_admin(user: User) -> None:
    """Raise GrantMissingError for a user who is not an admin."""
    if not user.is_admin:
        raise GrantMissingError(f"cannot do this as user {user.name}: it is for admins")
