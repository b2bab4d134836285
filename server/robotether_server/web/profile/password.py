"""/profile/password and /profile/log-out: change one's own password, end one's own logins."""

from flask import Blueprint
from werkzeug.wrappers import Response as AnyResponse

from robotether_server import passwords
from robotether_server.administration import users
from robotether_server.problems import FieldInvalid
from robotether_server.store import logins
from robotether_server.web import access, deeds, forms, logging_in, visitors
from robotether_server.web.deeds import METHODS, Deed, Field
from robotether_server.web.parts import parts
from robotether_server.web.profile.overview import PAGE

blueprint = Blueprint("password", __name__)


@blueprint.route("/password", methods=METHODS)
def change() -> AnyResponse:
    """Change the password of who asks, and keep this browser logged in."""
    deed = Deed(
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
                hint=f"At least {passwords.SHORTEST} characters.",
                kind="password",
            ),
            Field("again", "New password again", kind="password"),
        ),
        is_harmless=True,
    )
    new_login: list[str] = []
    response = deeds.ask_first(deed, lambda: new_login.append(_change()))
    for text in new_login:
        access.set_login(response, text)
    return response


@blueprint.route("/log-out", methods=METHODS)
def log_out_everywhere() -> AnyResponse:
    """End every login of who asks."""
    name = visitors.visitor().name
    deed = Deed(
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
    return deeds.run(deed, lambda tx, source: users.log_out_everywhere(tx, source, name))


def _change() -> str:
    """Check, change, and return the text of a new login for this browser."""
    user, source = visitors.visitor(), visitors.source()
    new = forms.secret("new")
    if new != forms.secret("again"):
        raise FieldInvalid("cannot change the password: the new one is not the same both times")
    logging_in.confirm(parts().database, source, forms.secret("present"))
    with parts().database.transaction() as tx:
        users.set_password(tx, source, user.name, new)
        return logins.create(tx, user, source.address or "", parts().login_lifetime.unused)
