"""What a site's Ansible asks: a certificate, and web with people in the real database."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import tls_web
from mariadb_server import MariaDb
from robotether_server.db import Database, users
from robotether_server.settings.server import (
    JoinSettings,
    SiteAddressSettings,
    TicketSettings,
    WebSettings,
)
from robotether_server.web import create_app
from tls_front import openssl
from tls_web import TlsWeb
from web_visitor import HASH


@pytest.fixture(scope="session")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
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
def web(
    mariadb: MariaDb, database: Database, certificate: Path, tmp_path: Path
) -> Iterator[TlsWeb]:
    """Root is admin, ann a user, and no robot is known."""
    host_keys = tmp_path / "host_keys"
    host_keys.mkdir()
    (host_keys / "ssh_host_ed25519_key.pub").write_text("ssh-ed25519 AAAAhost root@sshd\n")
    settings = WebSettings(
        database=mariadb.settings("web"),
        tickets=TicketSettings("t" * 32, 30),
        join=JoinSettings("approve", 3, None, (2222, 443), host_keys, allow_local_macs=False),
        site_address=SiteAddressSettings(None, 443, ("127.0.0.1", 1)),
        agent_files_dir=tmp_path / "agent",
        secret_key="w" * 32,
        login_ttl_h=12,
        login_idle_h=4,
        log_level="info",
    )
    with database.transaction() as tx:
        users.add(tx, "root", HASH, "admin")
        users.add(tx, "ann", HASH, "user")
    with tls_web.running(create_app(settings), database, certificate) as served:
        yield served
