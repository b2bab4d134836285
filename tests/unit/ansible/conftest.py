"""What a site's Ansible asks: a certificate, and web with people in the real database."""

import pytest
import tls_web
from dated_certificate import make_certificate
from robotether_server.db import users
from robotether_server.web import create_app
from web_visitor import HASH, web_settings_of, write_host_key


@pytest.fixture(scope="session")
def certificate(tmp_path_factory):
    """One for 127.0.0.1, with its key."""
    return make_certificate(tmp_path_factory.mktemp("tls"))


@pytest.fixture
def web(mariadb, database, certificate, tmp_path):
    """Root is admin, ann a user, and no robot is known."""
    write_host_key(tmp_path)
    with database.transaction() as tx:
        users.add(tx, "root", HASH, "admin")
        users.add(tx, "ann", HASH, "user")
    settings = web_settings_of(mariadb.settings("web"), tmp_path)
    with tls_web.running(create_app(settings), database, certificate) as served:
        yield served
