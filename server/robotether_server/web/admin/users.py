"""/admin/users: who may log in, and the form for one more; /admin/users/NAME: one of them."""

from flask import Blueprint, render_template, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server import passwords
from robotether_server.api.context import context
from robotether_server.db import groups, robots, users
from robotether_server.db.grants import LEVELS
from robotether_server.db.users import ROLES
from robotether_server.problems import Problem
from robotether_server.services import tokens
from robotether_server.services import users as user_service
from robotether_server.services.names import MAX_NAME_LENGTH
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.admin import grant_lists

blueprint = Blueprint("users", __name__, url_prefix="/users")


@blueprint.get("")
def show_all() -> str:
    """Show every user."""
    return _list()


@blueprint.post("")
def add() -> AnyResponse | str | tuple[str, int]:
    """Add a user; a password that was made is in the answer, this one time."""
    typed = forms.secret("password")
    password = typed or passwords.new_password()
    try:
        name = forms.text("name", "Name", MAX_NAME_LENGTH)
        role = forms.choice("role", "Role", ROLES)
        with context().database.transaction() as tx:
            user_service.add(tx, current_user.source(), name, password, role)
    except Problem as problem:
        return _list(problem), problem.status
    if typed:
        return confirmation.go_on(page_of(name), f"User {name} is added.")
    return show_password(name, password, f"User {name} is added")


@blueprint.get("/<name>")
def show(name: str) -> str:
    """Show one user."""
    return render(name)


def show_password(name: str, password: str, title: str) -> str:
    """Return the page that shows a password, in the answer to the form that asked for it."""
    return render_template(
        "admin/secret.html",
        title=title,
        secret=password,
        what=f"The password of {name}",
        advice=f"Hand it to {name} over a safe way. Everybody can change their own password in their profile.",
        back=page_of(name),
    )


def render(name: str, problem: Problem | None = None) -> str:
    """Return the page of a user, with what went wrong in one of its forms; raise RecordMissing."""
    with context().database.transaction() as tx:
        user = users.get(tx, name)
        return render_template(
            "admin/user.html",
            subject=user,
            grants=grant_lists.of_user(tx, user),
            groups=[one.name for one in groups.list_all(tx) if name in one.members],
            tokens=tokens.list_of(tx, user),
            choices=grant_lists.scopes(tx),
            levels=LEVELS,
            problem=problem,
            values=request.form,
        )


def page_of(name: str) -> str:
    """Return the path of a user's page."""
    return f"/admin/users/{name}"


def _list(problem: Problem | None = None) -> str:
    with context().database.transaction() as tx:
        everyone = users.list_all(tx)
        seen = robots.count_seen(tx)
    return render_template(
        "admin/users.html",
        users=everyone,
        seen=seen,
        shortest_password=passwords.MIN_LENGTH,
        problem=problem,
        values=request.form,
    )
