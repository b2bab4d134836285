"""Finds the user of a page before its handler runs, for blueprints that need a login or an admin.

Used by the admin pages and the profile. `flask.g` holds the user of this request with the levels that the user has on
any robot, which decide about the menu; admin pages also get the number of waiting keys, for the badge there.
"""

from urllib.parse import quote

from flask import Flask, g, redirect, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.api import auth
from robotether_server.api.context import context
from robotether_server.db import Transaction, robots, seen_robots
from robotether_server.db.audit import Source
from robotether_server.db.users import User
from robotether_server.problems import GrantMissingError, LoginMissingError
from robotether_server.schemas import Level


def register(app: Flask) -> None:
    """Give every template the current user, error pages included."""
    app.context_processor(_for_templates)


def require_user() -> AnyResponse | None:
    """Identify the user; without a login redirect to the log-in page, and raise LoginMissingError for a form."""
    with context().database.transaction() as tx:
        user = auth.page_user(tx, request)
        if user is None and request.method == "POST":
            raise LoginMissingError("Your login has ended.")
        if user is None:
            return to_login()
        remember(tx, user)
    return None


def require_admin() -> AnyResponse | None:
    """Identify the user as `require_user` does; raise GrantMissingError unless it is an admin."""
    answer = require_user()
    if answer is None and not get().is_admin:
        raise GrantMissingError("This page is for administrators.")
    return answer


def remember(tx: Transaction, user: User) -> None:
    """Keep the user and its levels for the templates, and for an admin how many keys wait."""
    g.user = user
    g.levels = seen_robots.levels_of(tx, user)
    g.waiting = len(robots.list_waiting(tx)) if user.is_admin else 0


def to_login() -> AnyResponse:
    """Redirect to the log-in page, and back here afterwards."""
    return redirect(f"/login?next={quote(request.full_path.rstrip('?'))}")


def get() -> User:
    """Return the user of this request; only for blueprints that need one."""
    user: User = g.user
    return user


def levels() -> frozenset[Level]:
    """Return the levels that this user has on any robot; only for blueprints that need one."""
    user_levels: frozenset[Level] = g.levels
    return user_levels


def source() -> Source:
    """Return who does what this request asks for, for the audit log."""
    return Source(get().name, request.remote_addr)


def _for_templates() -> dict[str, object]:
    return {
        "user": g.get("user"),
        "own_levels": g.get("levels", frozenset()),
        "waiting_count": g.get("waiting", 0),
    }
