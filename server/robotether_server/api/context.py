"""What every request handler of one application shares."""

from dataclasses import dataclass, field
from pathlib import Path

from flask import current_app
from flask_wtf.csrf import CSRFProtect  # type: ignore[import-untyped] # it has no types

from robotether_server.api.recent_users import RecentUsers
from robotether_server.api.web_metrics import WebMetrics
from robotether_server.db import Database
from robotether_server.db.credentials import Lifetime
from robotether_server.install_line import SiteCertificates
from robotether_server.services.health import SshProbe
from robotether_server.services.history import Prometheus
from robotether_server.settings.server import JoinSettings
from robotether_server.tickets import TicketSigner

csrf = CSRFProtect()


@dataclass(frozen=True)
class AppContext:
    """Made once by create_app."""

    database: Database
    signer: TicketSigner
    join: JoinSettings
    site_certificates: SiteCertificates
    agent_files_dir: Path
    login_lifetime: Lifetime
    wall_robots: int
    backup_record: Path
    database_record: Path
    metrics: WebMetrics
    ssh_probe: SshProbe
    prometheus: Prometheus
    recent_users: RecentUsers = field(default_factory=RecentUsers)


def context() -> AppContext:
    """Return the parts of the application that handles this request."""
    app_context: AppContext = current_app.extensions["robotether"]
    return app_context
