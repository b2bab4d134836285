"""Programs of the application's users: ann drives sim1, root is admin."""

from dataclasses import replace

import pytest
from api_visitor import program_of
from robotether_server.install_line import Certificate, SiteCertificates
from robotether_server.settings.server import SiteAddressSettings

PIN = "q83vEjRWeJA+/q83vEjRWeJAq83vEjRWeJAq83vEjRW="


class KnownCertificate(SiteCertificates):
    def certificate(self, host):
        return Certificate("ab" * 32, PIN, is_known=False)


@pytest.fixture
def site_certificate(app):
    context = app.extensions["robotether"]
    settings = SiteAddressSettings(None, 443, ("nobody", 1))
    app.extensions["robotether"] = replace(context, site_certificates=KnownCertificate(settings))


@pytest.fixture
def root(program, database):
    return program_of(program, database, "root")


@pytest.fixture
def ann(program, database):
    """A program of a user who may drive sim1 and nothing else."""
    return program_of(program, database, "ann")
