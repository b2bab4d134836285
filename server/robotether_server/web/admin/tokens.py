"""/admin/tokens: the API tokens of all users. Each user makes their own in the profile."""

import datetime as dt

from flask import Blueprint, render_template
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.api.context import context
from robotether_server.db.tokens import Token
from robotether_server.problems import RecordMissing
from robotether_server.services import tokens
from robotether_server.web import confirmation
from robotether_server.web.confirmation import METHODS, ConfirmedAction

blueprint = Blueprint("tokens", __name__, url_prefix="/tokens")


@blueprint.get("")
def show() -> str:
    """Show every API token."""
    with context().database.transaction() as tx:
        found = tokens.list_all(tx)
    return render_template("admin/tokens.html", tokens=found, now=dt.datetime.now(dt.UTC))


@blueprint.route("/<int:token_id>/delete", methods=METHODS)
def delete(token_id: int) -> AnyResponse:
    """Delete a token."""
    token = _get(token_id)
    action = ConfirmedAction(
        title=f"Delete API token {token.name} of {token.user}?",
        effects=(
            "Programs that use it are refused from now on; what they have open is cut within 2 seconds.",
        ),
        undo=f"A deleted token cannot be brought back; {token.user} makes another one in the profile.",
        button="Delete",
        done=f"API token {token.name} of {token.user} is deleted.",
        back="/admin/tokens",
    )
    return confirmation.run(action, lambda tx, source: tokens.delete(tx, source, token_id))


def _get(token_id: int) -> Token:
    with context().database.transaction() as tx:
        for token in tokens.list_all(tx):
            if token.id == token_id:
                return token
    raise RecordMissing("cannot find that API token: it was deleted already")
