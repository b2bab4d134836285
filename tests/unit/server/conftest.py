"""Settings and a web client that the server's tests share."""

from __future__ import annotations

from pathlib import Path

import pytest
from mariadb_server import MariaDb
from robotether_server.settings import (
    JoinSettings,
    SiteAddressSettings,
    TicketSettings,
    WebSettings,
)

TICKET_KEY = "t" * 32
SSH_HOST_KEY = "ssh-ed25519 AAAAhost"


@pytest.fixture
def web_settings(mariadb: MariaDb, tmp_path: Path) -> WebSettings:
    """What web runs with, against the real database."""
    host_keys = tmp_path / "host_keys"
    host_keys.mkdir()
    (host_keys / "ssh_host_ed25519_key.pub").write_text(f"{SSH_HOST_KEY} root@sshd\n")
    return WebSettings(
        database=mariadb.settings("web"),
        tickets=TicketSettings(TICKET_KEY, 30),
        join=JoinSettings("approve", 3, None, (2222, 443), host_keys, allow_local_macs=True),
        site_address=SiteAddressSettings(None, 443, ("127.0.0.1", 1)),
        agent_files_dir=tmp_path / "agent",
        secret_key="w" * 32,
        login_ttl_h=12,
        login_idle_h=4,
        log_level="info",
    )
