"""/profile/tokens: the API tokens with which one's programs log in."""

import datetime as dt

from flask import Blueprint, render_template, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.api.context import context
from robotether_server.db.tokens import Token
from robotether_server.problems import Problem, RecordMissing
from robotether_server.services import tokens
from robotether_server.services.names import MAX_NAME_LENGTH
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.confirmation import METHODS, ConfirmedAction
from robotether_server.web.pages.profile.overview import PAGE, render

blueprint = Blueprint("api_tokens", __name__, url_prefix="/tokens")

MAX_DAYS = 3650


@blueprint.route("", methods=METHODS)
def create() -> str | tuple[str, int]:
    """Make a token; the answer shows it, this one time."""
    if request.method == "GET":
        return render()
    try:
        name = forms.text("name", "Name", MAX_NAME_LENGTH)
        days = forms.optional_number("days", "Days", 1, MAX_DAYS)
        expires_at = dt.datetime.now(dt.UTC) + dt.timedelta(days=days) if days else None
        with context().database.transaction() as tx:
            text = tokens.create(tx, current_user.source(), current_user.get(), name, expires_at)
    except Problem as problem:
        return render(problem, "tokens"), problem.status
    return render_template(
        "admin/secret.html",
        title=f"API token {name} is made",
        secret=text,
        what="The token",
        advice="Programs send it as the header Authorization: Bearer TOKEN. It may do what you may do.",
        back=f"{PAGE}#tokens",
    )


@blueprint.route("/<int:token_id>/delete", methods=METHODS)
def delete(token_id: int) -> AnyResponse:
    """Delete a token of one's own."""
    token = _get(token_id)
    action = ConfirmedAction(
        title=f"Delete API token {token.name}?",
        effects=(
            "Programs that use it are refused from now on; what they have open is cut within 2 seconds.",
        ),
        undo="A deleted token cannot be brought back; make another one.",
        button="Delete",
        done=f"API token {token.name} is deleted.",
        back=f"{PAGE}#tokens",
    )
    return confirmation.run(action, lambda tx, source: tokens.delete(tx, source, token_id))


def _get(token_id: int) -> Token:
    """Return a token of who asks, and nobody else's."""
    with context().database.transaction() as tx:
        for token in tokens.list_of(tx, current_user.get()):
            if token.id == token_id:
                return token
    raise RecordMissing("cannot find that API token: it was deleted already, or is not yours")
