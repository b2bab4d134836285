"""/profile: a user's own password, SSH keys, API tokens, SSH configuration and logins."""

from functools import partial

from flask import Blueprint, render_template, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server import passwords
from robotether_server.api import auth
from robotether_server.api.context import context
from robotether_server.db import Transaction, credentials
from robotether_server.db.audit import Source
from robotether_server.db.credentials import TokenUse
from robotether_server.db.users import get_ssh_key, is_unchanged, list_ssh_keys
from robotether_server.install_line import site_of
from robotether_server.problems import (
    FieldInvalidError,
    LoginFailedError,
    RobotetherError,
    ThrottledError,
)
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import logging_in, ssh_keys, tokens, users
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.confirmation import ConfirmedAction, Field, Words
from robotether_server.web.forms import METHODS, Saved, form

blueprint = Blueprint("profile", __name__, url_prefix="/profile")
blueprint.before_request(current_user.require_user)

PAGE = "/profile"


@blueprint.get("")
def show(problem: RobotetherError | None = None, part: str = "") -> str:
    """Show the profile, with the problem of one of its forms, `part`."""
    user = current_user.get()
    with context().database.transaction() as tx:
        entries = ssh_keys.shell_entries(tx, user)
        now = tx.now()
        keys, own_tokens = list_ssh_keys(tx, user), credentials.list_tokens_of(tx, user)
    host = site_of(context().site_certificates.settings, request.host).host
    return render_template(
        "profile.html",
        keys=keys,
        tokens=own_tokens,
        config=ssh_keys.render_config(entries, host, context().join.ssh_ports[0])
        if entries
        else "",
        first=entries[0].robot if entries else "",
        now=now,
        problem=problem,
        problems={part: problem},
        values=request.form,
    )


@form(blueprint, "/ssh-keys", partial(show, part="ssh-keys"))
def add_key(tx: Transaction, source: Source) -> Saved:
    """Add a key."""
    name = forms.optional_text("name", "Name", MAX_NAME_LENGTH)
    # As it is: the text of a private key has many lines, and its refusal says what to give.
    line = request.form.get("public_key", "")
    key = ssh_keys.add(tx, source, current_user.get(), name, line)
    return f"{PAGE}#ssh-keys", f"SSH key {key.name} is added."


@form(blueprint, "/tokens", partial(show, part="tokens"))
def create_token(tx: Transaction, source: Source) -> Saved:
    """Create an API token; the answer shows it once."""
    name = forms.text("name", "Name", MAX_NAME_LENGTH)
    days = forms.optional_number("days", "Days", 1, tokens.MAX_DAYS)
    only_for: TokenUse | None = "metrics" if forms.is_ticked("metrics") else None
    rights = "It reads the metrics, and nothing else." if only_for else "It may do what you may do."
    return render_template(
        "admin/secret.html",
        title=f"API token {name} is created",
        secret=tokens.create(tx, source, current_user.get(), name, days, only_for=only_for),
        what="The token",
        advice=f"Programs send it as the header Authorization: Bearer TOKEN. {rights}",
        back=f"{PAGE}#tokens",
    )


@blueprint.route("/password", methods=METHODS)
def change_password() -> AnyResponse:
    """Change the user's password, and keep this browser logged in."""
    return confirmation.ask_first(CHANGE_PASSWORD, PAGE, {}, _change_password)


def _change_password() -> AnyResponse:
    """Check and change; no transaction is open while the present password is checked, which takes long."""
    user, source = current_user.get(), current_user.source()
    new = forms.secret("new")
    if new != forms.secret("again"):
        raise FieldInvalidError("cannot change the password: the two new ones differ", "again")
    try:
        logging_in.confirm(context().database, source, forms.secret("present"))
    except (LoginFailedError, ThrottledError) as problem:
        problem.field = "present"
        raise
    with forms.named({"password": "new"}), context().database.transaction() as tx:
        if not is_unchanged(tx, user):
            raise LoginFailedError("cannot change the password: an admin has changed it meanwhile")
        users.set_password(tx, source, user.name, new)
        text = credentials.create_login(
            tx, user, source.address or "", context().login_lifetime.unused
        )
    response = forms.go_on(PAGE, CHANGE_PASSWORD.done)
    auth.set_login(response, text)
    return response


def _log_out_everywhere(tx: Transaction, source: Source) -> None:
    users.log_out_everywhere(tx, source, current_user.get().name)


def _key_words(key_id: int) -> Words:
    with context().database.transaction() as tx:
        return {"key": get_ssh_key(tx, current_user.get(), key_id)}


def _delete_key(tx: Transaction, source: Source, key_id: int) -> None:
    ssh_keys.delete(tx, source, current_user.get(), key_id)


def _token_words(token_id: int) -> Words:
    """Return a token of this user, and nobody else's."""
    with context().database.transaction() as tx:
        return {"token": credentials.get_token(tx, token_id, current_user.get())}


CHANGE_PASSWORD = ConfirmedAction(
    path="/password",
    title="Change your password",
    effects=(
        "Every other browser that is logged in as you has to log in again.",
        "Your API tokens and SSH keys stay.",
    ),
    undo="Change it again at any time; an admin can set another one if you forget it.",
    button="Change the password",
    done="Your password is changed.",
    do=_change_password,
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
confirmation.register(
    blueprint,
    PAGE,
    dict,
    ConfirmedAction(
        path="/log-out",
        title="Log out everywhere?",
        effects=(
            "Every browser that is logged in as you, this one too, has to log in again.",
            "What you drive there stops within 2 seconds. Your API tokens and SSH keys stay.",
        ),
        undo="Log in again.",
        button="Log out everywhere",
        done="You are logged out everywhere.",
        do=_log_out_everywhere,
        onward="/login",
    ),
)
confirmation.register(
    blueprint,
    f"{PAGE}#ssh-keys",
    _key_words,
    ConfirmedAction(
        path="/ssh-keys/<int:key_id>/delete",
        title="Delete SSH key {key.name}?",
        effects=(
            "The key {key.fingerprint} no longer opens a shell; connections with it are cut within 2 seconds.",
        ),
        undo="Add the key again.",
        button="Delete",
        done="SSH key {key.name} is deleted.",
        do=_delete_key,
    ),
)
confirmation.register(
    blueprint,
    f"{PAGE}#tokens",
    _token_words,
    ConfirmedAction(
        path="/tokens/<int:token_id>/delete",
        title="Delete API token {token.name}?",
        effects=(
            "Programs that use it are rejected from now on; their connections are cut within 2 seconds.",
            "The join tokens and SSH keys that they made with it are deleted, too.",
        ),
        undo="A deleted token cannot be restored; create another one.",
        button="Delete",
        done="API token {token.name} is deleted.",
        do=tokens.delete,
    ),
)
