"""/profile/password and /profile/log-out: change one's own password, end one's own logins."""

from flask import Blueprint
from werkzeug.wrappers import Response as AnyResponse

from robotether_server import passwords
from robotether_server.api import auth
from robotether_server.api.context import context
from robotether_server.db import logins
from robotether_server.problems import FieldInvalid
from robotether_server.services import logging_in, users
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.confirmation import METHODS, ConfirmedAction, Field
from robotether_server.web.pages.profile.overview import PAGE

blueprint = Blueprint("password", __name__)


@blueprint.route("/password", methods=METHODS)
def change() -> AnyResponse:
    """Change the password of who asks, and keep this browser logged in."""
    action = ConfirmedAction(
        title="Change your password",
        effects=(
            "Every other browser that is logged in as you has to log in again.",
            "Your API tokens and SSH keys stay.",
        ),
        undo="Change it again at any time; an admin can set another one if you forget it.",
        button="Change the password",
        done="Your password is changed.",
        back=PAGE,
        fields=(
            Field("present", "Present password", kind="password"),
            Field(
                "new",
                "New password",
                hint=f"At least {passwords.MIN_LENGTH} characters.",
                kind="password",
            ),
            Field("again", "New password again", kind="password"),
        ),
        is_harmless=True,
    )
    new_login: list[str] = []
    response = confirmation.ask_first(action, lambda: new_login.append(_change()))
    for text in new_login:
        auth.set_login(response, text)
    return response


@blueprint.route("/log-out", methods=METHODS)
def log_out_everywhere() -> AnyResponse:
    """End every login of who asks."""
    name = current_user.get().name
    action = ConfirmedAction(
        title="Log out everywhere?",
        effects=(
            "Every browser that is logged in as you, this one too, has to log in again.",
            "What you drive there stops within 2 seconds. Your API tokens and SSH keys stay.",
        ),
        undo="Log in again.",
        button="Log out everywhere",
        done="You are logged out everywhere.",
        back=PAGE,
        onward="/login",
    )
    return confirmation.run(action, lambda tx, source: users.log_out_everywhere(tx, source, name))


def _change() -> str:
    """Check, change, and return the text of a new login for this browser."""
    user, source = current_user.get(), current_user.source()
    new = forms.secret("new")
    if new != forms.secret("again"):
        raise FieldInvalid("cannot change the password: the new one is not the same both times")
    logging_in.confirm(context().database, source, forms.secret("present"))
    with context().database.transaction() as tx:
        users.set_password(tx, source, user.name, new)
        return logins.create(tx, user, source.address or "", context().login_lifetime.unused)
