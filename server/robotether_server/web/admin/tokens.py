"""/admin/tokens: the API tokens of all users, who make them in the profile; /admin/join-tokens: those for robots."""

import datetime as dt

from flask import Blueprint, render_template, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.api.context import context
from robotether_server.db.credentials import Token
from robotether_server.db.robots import JoinToken
from robotether_server.install_line import install_line
from robotether_server.problems import Problem, RecordMissing
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import tokens
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.confirmation import METHODS, ConfirmedAction

blueprint = Blueprint("tokens", __name__)


MAX_USES = 10_000
MAX_HOURS = 8760


@blueprint.get("/tokens")
def show() -> str:
    """Show every API token."""
    with context().database.transaction() as tx:
        found = tokens.list_all(tx)
    return render_template("admin/tokens.html", tokens=found, now=dt.datetime.now(dt.UTC))


@blueprint.route("/tokens/<int:token_id>/delete", methods=METHODS)
def delete(token_id: int) -> AnyResponse:
    """Delete a token."""
    token = _get(token_id)
    action = ConfirmedAction(
        title=f"Delete API token {token.name} of {token.user}?",
        effects=(
            "Programs that use it are rejected from now on; their connections are cut within 2 seconds.",
        ),
        undo=f"A deleted token cannot be restored; {token.user} creates another one in the profile.",
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
    raise RecordMissing("cannot find that API token: it was already deleted")


@blueprint.get("/join-tokens")
def show_join_tokens() -> str:
    """Show every join token."""
    return _page()


@blueprint.post("/join-tokens")
def create_join_token() -> str | tuple[str, int]:
    """Create a join token; the answer shows the install line once."""
    try:
        name = forms.text("name", "Name", MAX_NAME_LENGTH)
        uses = forms.number("uses", "Uses", 1, MAX_USES)
        hours = forms.number("hours", "Hours", 1, MAX_HOURS)
        expires_at = dt.datetime.now(dt.UTC) + dt.timedelta(hours=hours)
        with context().database.transaction() as tx:
            token = tokens.create_join_token(tx, current_user.source(), name, uses, expires_at)
            # This may raise: without a certificate to pin there is no install line, and so no token.
            line = install_line(context().site_certificates, request.host, token)
    except Problem as problem:
        return _page(problem), problem.status
    return render_template(
        "admin/install_line.html",
        name=name,
        uses=uses,
        expires_at=expires_at,
        line=line,
        token=token,
    )


@blueprint.route("/join-tokens/<int:token_id>/delete", methods=METHODS)
def delete_join_token(token_id: int) -> AnyResponse:
    """Delete a token."""
    token = _get_join_token(token_id)
    action = ConfirmedAction(
        title=f"Delete join token {token.name}?",
        effects=(
            f"No robot can join with it from now on; {token.uses - token.used} of {token.uses} uses are left.",
            "Robots that joined with it stay.",
        ),
        undo="A deleted token cannot be restored; create another one.",
        button="Delete",
        done=f"Join token {token.name} is deleted.",
        back="/admin/join-tokens",
    )
    return confirmation.run(
        action, lambda tx, source: tokens.delete_join_token(tx, source, token_id)
    )


def _page(problem: Problem | None = None) -> str:
    with context().database.transaction() as tx:
        found = tokens.list_join_tokens(tx)
    return render_template(
        "admin/join_tokens.html",
        tokens=found,
        now=dt.datetime.now(dt.UTC),
        problem=problem,
        values=request.form,
    )


def _get_join_token(token_id: int) -> JoinToken:
    with context().database.transaction() as tx:
        for token in tokens.list_join_tokens(tx):
            if token.id == token_id:
                return token
    raise RecordMissing("cannot find that join token: it was already deleted")
