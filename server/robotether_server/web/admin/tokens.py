"""/admin/tokens: the API tokens of all users, who make them in the profile; /admin/join-tokens: those for robots."""

import datetime as dt

from flask import Blueprint, render_template, request

from robotether_server.api.context import context
from robotether_server.db import Transaction, credentials, join_tokens
from robotether_server.db.audit import Source
from robotether_server.install_line import install_line
from robotether_server.problems import Problem
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import tokens
from robotether_server.web import confirmation, forms
from robotether_server.web.confirmation import ConfirmedAction, Words
from robotether_server.web.forms import Saved, form

blueprint = Blueprint("tokens", __name__)

MAX_HOURS = 8760


@blueprint.get("/tokens")
def show() -> str:
    """Show every API token."""
    with context().database.transaction() as tx:
        found = credentials.list_tokens(tx)
    return render_template("admin/tokens.html", tokens=found, now=dt.datetime.now(dt.UTC))


def show_join_tokens(problem: Problem | None = None) -> str:
    """Show every join token."""
    with context().database.transaction() as tx:
        found = join_tokens.list_all(tx)
    return render_template(
        "admin/join_tokens.html",
        tokens=found,
        now=dt.datetime.now(dt.UTC),
        problem=problem,
        values=request.form,
    )


@form(blueprint, "/join-tokens", show_join_tokens)
def create_join_token(tx: Transaction, source: Source) -> Saved:
    """Create a join token; the answer shows the install line once."""
    name = forms.text("name", "Name", MAX_NAME_LENGTH)
    uses = forms.number("uses", "Uses", 1, tokens.MAX_USES)
    hours = forms.number("hours", "Hours", 1, MAX_HOURS)
    expires_at = dt.datetime.now(dt.UTC) + dt.timedelta(hours=hours)
    token = tokens.create_join_token(tx, source, name, uses, expires_at)
    return render_template(
        "admin/install_line.html",
        name=name,
        uses=uses,
        expires_at=expires_at,
        # This may raise: without a certificate to pin there is no install line, and so no token.
        line=install_line(context().site_certificates, request.host, token),
        token=token,
    )


def _found(token_id: int) -> Words:
    with context().database.transaction() as tx:
        found = credentials.list_tokens(tx)
    missing = "cannot find that API token: it was already deleted"
    return {"token": confirmation.pick(found, token_id, missing)}


def _found_join_token(token_id: int) -> Words:
    with context().database.transaction() as tx:
        found = join_tokens.list_all(tx)
    token = confirmation.pick(
        found, token_id, "cannot find that join token: it was already deleted"
    )
    return {"token": token, "uses_left": token.uses - token.used}


confirmation.register(
    blueprint,
    "/admin/tokens",
    _found,
    ConfirmedAction(
        path="/tokens/<int:token_id>/delete",
        title="Delete API token {token.name} of {token.user}?",
        effects=(
            "Programs that use it are rejected from now on; their connections are cut within 2 seconds.",
        ),
        undo="A deleted token cannot be restored; {token.user} creates another one in the profile.",
        button="Delete",
        done="API token {token.name} of {token.user} is deleted.",
        do=tokens.delete,
    ),
)
confirmation.register(
    blueprint,
    "/admin/join-tokens",
    _found_join_token,
    ConfirmedAction(
        path="/join-tokens/<int:token_id>/delete",
        title="Delete join token {token.name}?",
        effects=(
            "No robot can join with it from now on; {uses_left} of {token.uses} uses are left.",
            "Robots that joined with it stay.",
        ),
        undo="A deleted token cannot be restored; create another one.",
        button="Delete",
        done="Join token {token.name} is deleted.",
        do=tokens.delete_join_token,
    ),
)
