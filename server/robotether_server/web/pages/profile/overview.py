"""The profile page itself."""

import datetime as dt

from flask import Blueprint, render_template, request

from robotether_server.api.context import context
from robotether_server.install_line import site_of
from robotether_server.problems import Problem
from robotether_server.services import ssh_config, ssh_keys, tokens
from robotether_server.web import current_user

blueprint = Blueprint("overview", __name__)

PAGE = "/profile"


@blueprint.get("")
def show() -> str:
    """Show the profile."""
    return render()


def render(problem: Problem | None = None, form: str = "") -> str:
    """Return the page, with what went wrong in one of its forms, `form`."""
    user = current_user.get()
    with context().database.transaction() as tx:
        entries = ssh_config.entries(tx, user)
        keys, own_tokens = ssh_keys.list_of(tx, user), tokens.list_of(tx, user)
    host = site_of(context().site_certificates.settings, request.host).host
    return render_template(
        "profile.html",
        keys=keys,
        tokens=own_tokens,
        config=ssh_config.render(entries, host, context().join.ssh_ports[0]) if entries else "",
        first=entries[0].robot if entries else "",
        now=dt.datetime.now(dt.UTC),
        problems={form: problem},
        values=request.form,
    )
