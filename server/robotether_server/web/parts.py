"""What every request handler of one application shares."""

from dataclasses import dataclass
from pathlib import Path

from flask import current_app
from flask_wtf.csrf import CSRFProtect  # type: ignore[import-untyped] # it has no types

from robotether_server.front import Front
from robotether_server.settings import JoinSettings
from robotether_server.store import Database
from robotether_server.store.logins import Lifetime
from robotether_server.tickets import TicketSigner

csrf = CSRFProtect()


@dataclass(frozen=True)
class Parts:
    """Made once by create_app."""

    database: Database
    signer: TicketSigner
    join: JoinSettings
    front: Front
    agent_files_dir: Path
    login_lifetime: Lifetime


def parts() -> Parts:
    """Return the parts of the application that handles this request."""
    found: Parts = current_app.extensions["robotether"]
    return found
