"""Programs of the application's users: ann drives sim1, root is admin."""

from __future__ import annotations

from dataclasses import replace

import pytest
from api_visitor import Program, program_of
from flask import Flask
from robotether_server.db import Database
from robotether_server.install_line import Certificate, SiteCertificates
from robotether_server.settings.server import SiteAddressSettings
from web_visitor import Browser

PIN = "q83vEjRWeJA+/q83vEjRWeJAq83vEjRWeJAq83vEjRW="


class KnownCertificate(SiteCertificates):
    """Certificates of which one is known beforehand."""

    def certificate(self, host: str) -> Certificate:
        """The same, whatever the name."""
        return Certificate("ab" * 32, PIN, is_known=False)


@pytest.fixture
def site_certificate(app: Flask) -> None:
    """A certificate that nginx shows."""
    context = app.extensions["robotether"]
    settings = SiteAddressSettings(None, 443, ("nobody", 1))
    app.extensions["robotether"] = replace(context, site_certificates=KnownCertificate(settings))


@pytest.fixture
def root(program: Browser, database: Database) -> Program:
    """An admin's program."""
    return program_of(program, database, "root")


@pytest.fixture
def ann(program: Browser, database: Database) -> Program:
    """A program of a user who may drive sim1 and nothing else."""
    return program_of(program, database, "ann")
