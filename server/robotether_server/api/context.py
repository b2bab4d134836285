"""What every request handler of one application shares."""

from dataclasses import dataclass, field
from pathlib import Path

from flask import current_app
from flask_wtf.csrf import CSRFProtect  # type: ignore[import-untyped] # it has no types

from robotether_server.api.recent_users import RecentUsers
from robotether_server.api.web_metrics import WebMetrics
from robotether_server.db import Database, Transaction, cells
from robotether_server.db.cells import Cell
from robotether_server.db.credentials import Lifetime
from robotether_server.install_line import SiteAddress, SiteCertificates
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

    def other_cells(self, tx: Transaction) -> list[tuple[Cell, str]]:
        """Return the site's machines that have other pages than this one, and the authority of their URLs."""
        # By whichever of its names this one was opened.
        own = self.site_certificates.settings
        return [
            (cell, SiteAddress(cell.host, cell.https_port).authority)
            for cell in cells.read(tx)
            if cell.host is not None
            and (cell.host, cell.https_port) != (own.public_host, own.public_port)
        ]


def context() -> AppContext:
    """Return the parts of the application that handles this request."""
    app_context: AppContext = current_app.extensions["robotether"]
    return app_context
