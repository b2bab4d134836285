"""/admin/users: every user; /admin/users/NAME: one of them, and what an admin changes after a question."""

from functools import partial

from flask import Blueprint, make_response, render_template, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server import passwords
from robotether_server.api.context import context
from robotether_server.db import Transaction, credentials, seen_robots, users
from robotether_server.db.audit import Source
from robotether_server.db.grants import GROUPS, LEVELS
from robotether_server.db.users import ROLES
from robotether_server.problems import RobotetherError
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import users as user_service
from robotether_server.web import confirmation, forms
from robotether_server.web.admin import grants
from robotether_server.web.admin.selection import Selection
from robotether_server.web.confirmation import ConfirmedAction, Field, Words
from robotether_server.web.forms import Saved, form

USERS = Selection("user")
blueprint = Blueprint("users", __name__, url_prefix="/users")


def show_all(problem: RobotetherError | None = None) -> str:
    """Show every user."""
    with context().database.transaction() as tx:
        everyone = users.list_all(tx)
        seen = seen_robots.count_seen(tx)
        groups = GROUPS.names(tx)
        scopes = grants.scopes(tx)
    return render_template(
        "admin/users.html",
        users=everyone,
        seen=seen,
        ticked=USERS.of_list(user.name for user in everyone),
        groups=groups,
        scopes=scopes,
        levels=LEVELS,
        ends=grants.ENDS,
        shortest_password=passwords.MIN_LENGTH,
        problem=problem,
        values=request.form,
    )


@form(blueprint, "", show_all)
def add(tx: Transaction, source: Source) -> Saved:
    """Add a user; a generated password is shown once, in the answer."""
    typed = forms.secret("password")
    password = typed or passwords.new_password()
    name = forms.text("name", "Name", MAX_NAME_LENGTH)
    user_service.add(tx, source, name, password, forms.choice("role", "Role", ROLES))
    if typed:
        return page_of(name), f"User {name} is added."
    return _password_page(name, password, f"User {name} is added")


@blueprint.get("/<name>")
def show(name: str, problem: RobotetherError | None = None) -> str:
    """Show one user, with the problem of one of its forms."""
    with context().database.transaction() as tx:
        user = users.get(tx, name)
        return render_template(
            "admin/user.html",
            subject=user,
            grants=grants.of_user(tx, user),
            groups=[group.name for group in GROUPS.list_all(tx) if name in group.members],
            tokens=credentials.list_tokens_of(tx, user),
            choices=grants.scopes(tx),
            levels=LEVELS,
            problem=problem,
            values=request.form,
        )


def page_of(name: str) -> str:
    """Return the path of a user's page."""
    return f"/admin/users/{name}"


def _password_page(name: str, password: str, title: str) -> str:
    """Return the page that shows a password, in the answer to the form that asked for it."""
    return render_template(
        "admin/secret.html",
        title=title,
        secret=password,
        what=f"The password of {name}",
        advice=f"Give it to {name} in a safe way. Everybody can change their own password in their profile.",
        back=page_of(name),
    )


def _set_role(tx: Transaction, source: Source, name: str) -> None:
    user_service.set_role(tx, source, name, forms.choice("role", "Role", ROLES))


def _set_password(tx: Transaction, source: Source, name: str) -> AnyResponse | None:
    """Set a user's password; a generated one is shown once, in the answer."""
    typed = forms.secret("password")
    password = typed or passwords.new_password()
    user_service.set_password(tx, source, name, password)
    title = f"User {name} has a new password"
    return None if typed else make_response(_password_page(name, password, title))


def _words(name: str) -> Words:
    with context().database.transaction() as tx:
        user = users.get(tx, name)
    # What an admin may have written down: what ends, and what does not.
    tokens_left = (
        f"Join tokens that {name} made are deleted; the robots that they admitted stay. API tokens that "
        f"{name} made for others stay valid: check their list, and delete what should end."
    )
    return {
        "name": name,
        "meant": user.id,
        "role": user.role,
        "tokens_left": tokens_left if user.is_admin else "",
    }


grants.register_form(blueprint, "/<name>/grants", show, page_of)
confirmation.register(
    blueprint,
    "/admin/users/{name}",
    _words,
    ConfirmedAction(
        path="/<name>/role",
        title="Role of {name}",
        effects=(
            "An admin manages every robot and user, sees the audit log, and creates tokens that admit robots.",
            "A user sees and drives the robots that there are grants for.",
            "{tokens_left}",
        ),
        undo="Set the role of {name} back to {role}.",
        button="Save",
        done="The role of {name} is saved.",
        do=_set_role,
        fields=(Field("role", "Role", "{role}", options=tuple((role, role) for role in ROLES)),),
    ),
    ConfirmedAction(
        path="/<name>/disable",
        title="Disable user {name}?",
        effects=(
            "{name} is logged out everywhere; what {name} drives stops within 2 seconds.",
            "API tokens and SSH keys of {name} no longer work. They and the grants are kept.",
            "{tokens_left}",
        ),
        undo="Enable {name} again.",
        button="Disable",
        done="User {name} is disabled.",
        do=partial(user_service.set_disabled, disabled=True),
    ),
    ConfirmedAction(
        path="/<name>/enable",
        title="Enable user {name}?",
        effects=("{name} may log in again; API tokens, SSH keys and grants work as before.",),
        undo="Disable {name} again.",
        button="Enable",
        done="User {name} is enabled.",
        do=partial(user_service.set_disabled, disabled=False),
        is_harmless=True,
    ),
    ConfirmedAction(
        path="/<name>/password",
        title="New password for {name}",
        effects=(
            "The current password no longer works, and {name} is logged out everywhere.",
            "API tokens and SSH keys stay.",
        ),
        undo="The old password cannot be restored; set another one at any time.",
        button="Set the password",
        done="User {name} has a new password.",
        do=_set_password,
        fields=(
            Field(
                "password",
                "New password",
                hint=f"At least {passwords.MIN_LENGTH} characters. Leave it empty to have one generated.",
                kind="password",
            ),
        ),
    ),
    ConfirmedAction(
        path="/<name>/log-out",
        title="Log {name} out everywhere?",
        effects=(
            "Every browser of {name} has to log in again; what {name} drives there stops within 2 seconds.",
            "Password, API tokens and SSH keys stay.",
        ),
        undo="{name} logs in again.",
        button="Log out everywhere",
        done="User {name} is logged out everywhere.",
        do=user_service.log_out_everywhere,
    ),
    ConfirmedAction(
        path="/<name>/remove",
        title="Remove user {name}?",
        effects=(
            "{name} is removed, with grants, logins, API tokens and SSH keys; "
            "what {name} drives stops within 2 seconds.",
            "The audit log stays. To keep somebody out for a while, disable the user instead.",
            "{tokens_left}",
        ),
        undo="A removed user cannot be restored; add the user again, with new grants, tokens and keys.",
        button="Remove",
        done="User {name} is removed.",
        do=user_service.remove,
        onward="/admin/users",
    ),
)
