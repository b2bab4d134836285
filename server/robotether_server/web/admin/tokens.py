"""/admin/tokens: the API tokens of all users, who make them in the profile."""

from flask import Blueprint, render_template

from robotether_server.api.context import context
from robotether_server.db import credentials
from robotether_server.services import tokens
from robotether_server.web import confirmation
from robotether_server.web.confirmation import ConfirmedAction, Words

blueprint = Blueprint("tokens", __name__)


@blueprint.get("/tokens")
def show() -> str:
    """Show every API token."""
    with context().database.transaction() as tx:
        api_tokens, now = credentials.list_tokens(tx), tx.now()
    return render_template("admin/tokens.html", tokens=api_tokens, now=now)


def _words(token_id: int) -> Words:
    with context().database.transaction() as tx:
        return {"token": credentials.get_token(tx, token_id)}


confirmation.register(
    blueprint,
    "/admin/tokens",
    _words,
    ConfirmedAction(
        path="/tokens/<int:token_id>/delete",
        title="Delete API token {token.name} of {token.user}?",
        effects=(
            "Programs that use it are rejected from now on; their connections are cut within 2 seconds.",
            "The join tokens and SSH keys that they made with it are deleted, too.",
        ),
        undo="A deleted token cannot be restored; {token.user} creates another one in the profile.",
        button="Delete",
        done="API token {token.name} of {token.user} is deleted.",
        do=tokens.delete,
    ),
)
