"""/admin/users: every user; /admin/users/NAME: one of them, and what an admin changes after a question."""

from flask import Blueprint, render_template, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server import passwords
from robotether_server.api.context import context
from robotether_server.db import Transaction, grants, seen_robots, users
from robotether_server.db.audit import Source
from robotether_server.db.grants import LEVELS
from robotether_server.db.users import ROLES, User
from robotether_server.problems import Problem
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import tokens
from robotether_server.services import users as user_service
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.admin import grant_lists
from robotether_server.web.confirmation import METHODS, ConfirmedAction, Field

blueprint = Blueprint("users", __name__, url_prefix="/users")


@blueprint.get("")
def show_all() -> str:
    """Show every user."""
    return _list()


@blueprint.post("")
def add() -> AnyResponse | str | tuple[str, int]:
    """Add a user; a generated password is shown once, in the answer."""
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
        advice=f"Give it to {name} in a safe way. Everybody can change their own password in their profile.",
        back=page_of(name),
    )


def render(name: str, problem: Problem | None = None) -> str:
    """Return the page of a user, with the problem of one of its forms; raise RecordMissing."""
    with context().database.transaction() as tx:
        user = users.get(tx, name)
        return render_template(
            "admin/user.html",
            subject=user,
            grants=grant_lists.of_user(tx, user),
            groups=[one.name for one in grants.list_groups(tx) if name in one.members],
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
        seen = seen_robots.count_seen(tx)
    return render_template(
        "admin/users.html",
        users=everyone,
        seen=seen,
        shortest_password=passwords.MIN_LENGTH,
        problem=problem,
        values=request.form,
    )


@blueprint.route("/<name>/role", methods=METHODS)
def set_role(name: str) -> AnyResponse:
    """Make a user an admin, or an admin a user."""
    user = _get(name)
    action = ConfirmedAction(
        title=f"Role of {name}",
        effects=(
            "An admin manages every robot and user, sees the audit log, and creates tokens that admit robots.",
            "A user sees and drives the robots that there are grants for.",
            *_what_else_ends(user),
        ),
        undo=f"Set the role of {name} back to {user.role}.",
        button="Save",
        done=f"The role of {name} is saved.",
        back=page_of(name),
        fields=(Field("role", "Role", user.role, options=tuple((role, role) for role in ROLES)),),
    )

    def do(tx: Transaction, source: Source) -> None:
        user_service.set_role(tx, source, name, forms.choice("role", "Role", ROLES))

    return confirmation.run(action, do)


@blueprint.route("/<name>/disable", methods=METHODS)
def disable(name: str) -> AnyResponse:
    """Disable a user."""
    user = _get(name)
    action = ConfirmedAction(
        title=f"Disable user {name}?",
        effects=(
            f"{name} is logged out everywhere; what {name} drives stops within 2 seconds.",
            f"API tokens and SSH keys of {name} no longer work. They and the grants are kept.",
            *_what_else_ends(user),
        ),
        undo=f"Enable {name} again.",
        button="Disable",
        done=f"User {name} is disabled.",
        back=page_of(name),
    )
    return confirmation.run(
        action, lambda tx, source: user_service.set_disabled(tx, source, name, disabled=True)
    )


@blueprint.route("/<name>/enable", methods=METHODS)
def enable(name: str) -> AnyResponse:
    """Enable a disabled user."""
    _get(name)
    action = ConfirmedAction(
        title=f"Enable user {name}?",
        effects=(f"{name} may log in again; API tokens, SSH keys and grants work as before.",),
        undo=f"Disable {name} again.",
        button="Enable",
        done=f"User {name} is enabled.",
        back=page_of(name),
        is_harmless=True,
    )
    return confirmation.run(
        action, lambda tx, source: user_service.set_disabled(tx, source, name, disabled=False)
    )


@blueprint.route("/<name>/password", methods=METHODS)
def set_password(name: str) -> AnyResponse:
    """Set a user's password; a generated one is shown once, in the answer."""
    _get(name)
    typed = forms.secret("password")
    password = typed or passwords.new_password()
    action = ConfirmedAction(
        title=f"New password for {name}",
        effects=(
            f"The current password no longer works, and {name} is logged out everywhere.",
            "API tokens and SSH keys stay.",
        ),
        undo="The old password cannot be restored; set another one at any time.",
        button="Set the password",
        done=f"User {name} has a new password.",
        back=page_of(name),
        fields=(
            Field(
                "password",
                "New password",
                hint=f"At least {passwords.MIN_LENGTH} characters. Leave it empty to have one generated.",
                kind="password",
            ),
        ),
    )

    def do() -> None:
        with context().database.transaction() as tx:
            user_service.set_password(tx, current_user.source(), name, password)

    def show() -> str:
        return show_password(name, password, f"User {name} has a new password")

    return confirmation.ask_first(action, do, None if typed else show)


@blueprint.route("/<name>/log-out", methods=METHODS)
def log_out_everywhere(name: str) -> AnyResponse:
    """End the logins of a user."""
    _get(name)
    action = ConfirmedAction(
        title=f"Log {name} out everywhere?",
        effects=(
            f"Every browser of {name} has to log in again; what {name} drives there stops within 2 seconds.",
            "Password, API tokens and SSH keys stay.",
        ),
        undo=f"{name} logs in again.",
        button="Log out everywhere",
        done=f"User {name} is logged out everywhere.",
        back=page_of(name),
    )
    return confirmation.run(
        action, lambda tx, source: user_service.log_out_everywhere(tx, source, name)
    )


@blueprint.route("/<name>/remove", methods=METHODS)
def remove(name: str) -> AnyResponse:
    """Remove a user."""
    user = _get(name)
    action = ConfirmedAction(
        title=f"Remove user {name}?",
        effects=(
            f"{name} is removed, with grants, logins, API tokens and SSH keys; "
            f"what {name} drives stops within 2 seconds.",
            "The audit log stays. To keep somebody out for a while, disable the user instead.",
            *_what_else_ends(user),
        ),
        undo="A removed user cannot be restored; add the user again, with new grants, tokens and keys.",
        button="Remove",
        done=f"User {name} is removed.",
        back=page_of(name),
        onward="/admin/users",
    )
    return confirmation.run(action, lambda tx, source: user_service.remove(tx, source, name))


def _what_else_ends(user: User) -> tuple[str, ...]:
    """Return what an admin may have written down: what ends, and what does not."""
    if not user.is_admin:
        return ()
    return (
        f"Join tokens that {user.name} made are deleted; the robots that they admitted stay. API tokens that "
        f"{user.name} made for others stay valid: check their list, and delete what should end.",
    )


def _get(name: str) -> User:
    with context().database.transaction() as tx:
        return users.get(tx, name)
