"""/admin/backups: how old the last backup on this machine is, and how backups are made."""

from flask import Blueprint, render_template

from robotether_server.api.context import context
from robotether_server.backups import age_s, last_backup

blueprint = Blueprint("backups", __name__)


@blueprint.get("/backups")
def show() -> str:
    """Show when the last one was made and copied."""
    record = last_backup(context().backup_record)
    return render_template("admin/backups.html", last=record, age=age_s)
