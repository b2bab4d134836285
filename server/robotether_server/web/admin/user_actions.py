"""What an admin does with one user: role, disable, enable, a new password, log out everywhere, remove."""

from flask import Blueprint
from werkzeug.wrappers import Response as AnyResponse

from robotether_server import passwords
from robotether_server.api.context import context
from robotether_server.db import Transaction, users
from robotether_server.db.audit import Source
from robotether_server.db.users import ROLES, User
from robotether_server.services import users as user_service
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.admin.users import page_of, show_password
from robotether_server.web.confirmation import METHODS, ConfirmedAction, Field

blueprint = Blueprint("user_actions", __name__, url_prefix="/users/<name>")


@blueprint.route("/role", methods=METHODS)
def set_role(name: str) -> AnyResponse:
    """Make a user an admin, or an admin a user."""
    user = _get(name)
    action = ConfirmedAction(
        title=f"Role of {name}",
        effects=(
            "An admin manages every robot and user, sees the audit log, and makes tokens that let robots in.",
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


@blueprint.route("/disable", methods=METHODS)
def disable(name: str) -> AnyResponse:
    """Keep a user out."""
    user = _get(name)
    action = ConfirmedAction(
        title=f"Disable user {name}?",
        effects=(
            f"{name} is logged out everywhere; what {name} drives stops within 2 seconds.",
            f"API tokens and SSH keys of {name} work no more. They and the grants stay for later.",
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


@blueprint.route("/enable", methods=METHODS)
def enable(name: str) -> AnyResponse:
    """Let a disabled user in again."""
    _get(name)
    action = ConfirmedAction(
        title=f"Enable user {name}?",
        effects=(f"{name} may log in again; API tokens, SSH keys and grants hold as before.",),
        undo=f"Disable {name} again.",
        button="Enable",
        done=f"User {name} is enabled.",
        back=page_of(name),
        is_harmless=True,
    )
    return confirmation.run(
        action, lambda tx, source: user_service.set_disabled(tx, source, name, disabled=False)
    )


@blueprint.route("/password", methods=METHODS)
def set_password(name: str) -> AnyResponse:
    """Give a user another password; one that was made is in the answer, this one time."""
    _get(name)
    typed = forms.secret("password")
    password = typed or passwords.new_password()
    action = ConfirmedAction(
        title=f"New password for {name}",
        effects=(
            f"The present password works no more, and {name} is logged out everywhere.",
            "API tokens and SSH keys stay.",
        ),
        undo="The old password cannot be brought back; set another one at any time.",
        button="Set the password",
        done=f"User {name} has a new password.",
        back=page_of(name),
        fields=(
            Field(
                "password",
                "New password",
                hint=f"At least {passwords.MIN_LENGTH} characters. Leave it empty to have one made.",
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


@blueprint.route("/log-out", methods=METHODS)
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


@blueprint.route("/remove", methods=METHODS)
def remove(name: str) -> AnyResponse:
    """Remove a user."""
    user = _get(name)
    action = ConfirmedAction(
        title=f"Remove user {name}?",
        effects=(
            f"{name} goes, with grants, logins, API tokens and SSH keys; what {name} drives stops within 2 seconds.",
            "The audit log stays. To keep somebody out for a while, disable the user instead.",
            *_what_else_ends(user),
        ),
        undo="A removed user cannot be brought back; add the user anew, with new grants, tokens and keys.",
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
        f"Join tokens that {user.name} made are deleted; the robots that they let in stay. API tokens that "
        f"{user.name} made for others stay good: look through their list, and delete what should end.",
    )


def _get(name: str) -> User:
    with context().database.transaction() as tx:
        return users.get(tx, name)
