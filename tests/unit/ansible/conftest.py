"""What a site's Ansible asks: a certificate, and web with people in the real database."""

import pytest
import tls_web
from robotether_server.db import users
from robotether_server.web import create_app
from tls_front import openssl
from web_visitor import HASH, web_settings_of, write_host_key


@pytest.fixture(scope="session")
def certificate(tmp_path_factory):
    """One for 127.0.0.1, with its key."""
    key, file = (tmp_path_factory.mktemp("tls") / name for name in ("key.pem", "cert.pem"))
    openssl(
        *("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"),
        *("-days", "2", "-subj", "/CN=localhost", "-keyout", str(key), "-out", str(file)),
        *("-addext", "subjectAltName=IP:127.0.0.1"),
    )
    file.write_bytes(file.read_bytes() + key.read_bytes())
    return file


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
