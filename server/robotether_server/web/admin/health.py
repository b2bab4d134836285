"""/admin/health: how the site is, and was; its script fills it. /admin/backups: how old the last backup is."""

from flask import Blueprint, render_template

from robotether_server.api.context import context
from robotether_server.backups import age_s, last_backup
from robotether_server.db import robots

blueprint = Blueprint("health", __name__)


@blueprint.get("/health")
def show() -> str:
    """Show the parts now, and charts of one robot or all."""
    with context().database.transaction() as tx:
        names = robots.list_active_names(tx)
    return render_template("admin/health.html", robots=names)


@blueprint.get("/backups")
def show_backups() -> str:
    """Show when the last backup on this machine was made and copied, and how backups are made."""
    record = last_backup(context().backup_record)
    return render_template("admin/backups.html", last=record, age=age_s)
