"""/admin/health: how the site is, and was. Its script fills it by /api/v1/health."""

from flask import Blueprint, render_template

from robotether_server.api.context import context
from robotether_server.db import robots

blueprint = Blueprint("health", __name__)


@blueprint.get("/health")
def show() -> str:
    """Show the parts now, and charts of one robot or all."""
    with context().database.transaction() as tx:
        names = robots.list_active_names(tx)
    return render_template("admin/health.html", robots=names)
