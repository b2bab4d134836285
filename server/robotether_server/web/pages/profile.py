"""/profile: a user's own password, SSH keys, API tokens, SSH configuration and logins."""

import datetime as dt

from flask import Blueprint, render_template, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server import passwords
from robotether_server.api import auth
from robotether_server.api.context import context
from robotether_server.db import credentials
from robotether_server.db.credentials import Token
from robotether_server.db.users import SshKey
from robotether_server.identity import MAX_KEY_LENGTH
from robotether_server.install_line import site_of
from robotether_server.problems import FieldInvalid, Problem, RecordMissing
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import logging_in, ssh_keys, tokens, users
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.confirmation import METHODS, ConfirmedAction, Field

blueprint = Blueprint("profile", __name__, url_prefix="/profile")
blueprint.before_request(current_user.require_user)

PAGE = "/profile"


MAX_DAYS = 3650


@blueprint.get("")
def show() -> str:
    """Show the profile."""
    return render()


def render(problem: Problem | None = None, form: str = "") -> str:
    """Return the page, with the problem of one of its forms, `form`."""
    user = current_user.get()
    with context().database.transaction() as tx:
        entries = ssh_keys.shell_entries(tx, user)
        keys, own_tokens = ssh_keys.list_of(tx, user), tokens.list_of(tx, user)
    host = site_of(context().site_certificates.settings, request.host).host
    return render_template(
        "profile.html",
        keys=keys,
        tokens=own_tokens,
        config=ssh_keys.render_config(entries, host, context().join.ssh_ports[0])
        if entries
        else "",
        first=entries[0].robot if entries else "",
        now=dt.datetime.now(dt.UTC),
        problems={form: problem},
        values=request.form,
    )


@blueprint.route("/password", methods=METHODS)
def change_password() -> AnyResponse:
    """Change the user's password, and keep this browser logged in."""
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
    response = confirmation.ask_first(action, lambda: new_login.append(_change_password()))
    for text in new_login:
        auth.set_login(response, text)
    return response


@blueprint.route("/log-out", methods=METHODS)
def log_out_everywhere() -> AnyResponse:
    """End every login of the user."""
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


def _change_password() -> str:
    """Check, change, and return the text of a new login for this browser."""
    user, source = current_user.get(), current_user.source()
    new = forms.secret("new")
    if new != forms.secret("again"):
        raise FieldInvalid("cannot change the password: the two new ones differ")
    logging_in.confirm(context().database, source, forms.secret("present"))
    with context().database.transaction() as tx:
        users.set_password(tx, source, user.name, new)
        return credentials.create_login(
            tx, user, source.address or "", context().login_lifetime.unused
        )


@blueprint.route("/ssh-keys", methods=METHODS)
def add_key() -> AnyResponse | str | tuple[str, int]:
    """Add a key."""
    if request.method == "GET":
        return render()
    try:
        name = forms.optional_text("name", "Name", MAX_NAME_LENGTH)
        line = forms.text("public_key", "Public key", MAX_KEY_LENGTH)
        with context().database.transaction() as tx:
            key = ssh_keys.add(tx, current_user.source(), current_user.get(), name, line)
    except Problem as problem:
        return render(problem, "ssh-keys"), problem.status
    return confirmation.go_on(f"{PAGE}#ssh-keys", f"SSH key {key.name} is added.")


@blueprint.route("/ssh-keys/<int:key_id>/delete", methods=METHODS)
def delete_key(key_id: int) -> AnyResponse:
    """Delete a key."""
    key = _get_key(key_id)
    action = ConfirmedAction(
        title=f"Delete SSH key {key.name}?",
        effects=(
            f"The key {key.fingerprint} no longer opens a shell; connections with it are cut within 2 seconds.",
        ),
        undo="Add the key again.",
        button="Delete",
        done=f"SSH key {key.name} is deleted.",
        back=f"{PAGE}#ssh-keys",
    )
    user = current_user.get()
    return confirmation.run(action, lambda tx, source: ssh_keys.delete(tx, source, user, key_id))


def _get_key(key_id: int) -> SshKey:
    with context().database.transaction() as tx:
        for key in ssh_keys.list_of(tx, current_user.get()):
            if key.id == key_id:
                return key
    raise RecordMissing("cannot find that SSH key: it was already deleted, or is not yours")


@blueprint.route("/tokens", methods=METHODS)
def create_token() -> str | tuple[str, int]:
    """Create an API token; the answer shows it once."""
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
        title=f"API token {name} is created",
        secret=text,
        what="The token",
        advice="Programs send it as the header Authorization: Bearer TOKEN. It may do what you may do.",
        back=f"{PAGE}#tokens",
    )


@blueprint.route("/tokens/<int:token_id>/delete", methods=METHODS)
def delete_token(token_id: int) -> AnyResponse:
    """Delete a token of one's own."""
    token = _get_token(token_id)
    action = ConfirmedAction(
        title=f"Delete API token {token.name}?",
        effects=(
            "Programs that use it are rejected from now on; their connections are cut within 2 seconds.",
        ),
        undo="A deleted token cannot be restored; create another one.",
        button="Delete",
        done=f"API token {token.name} is deleted.",
        back=f"{PAGE}#tokens",
    )
    return confirmation.run(action, lambda tx, source: tokens.delete(tx, source, token_id))


def _get_token(token_id: int) -> Token:
    """Return a token of this user, and nobody else's."""
    with context().database.transaction() as tx:
        for token in tokens.list_of(tx, current_user.get()):
            if token.id == token_id:
                return token
    raise RecordMissing("cannot find that API token: it was already deleted, or is not yours")
