"""The application of web with people and robots in the real database, and who visits it."""

import pytest
from granted import give
from robotether_server.db import robots, users
from robotether_server.settings.server import (
    JoinSettings,
    SiteAddressSettings,
    TicketSettings,
    WebSettings,
)
from robotether_server.web import create_app
from robotether_server.web.app import make_context
from web_visitor import HASH, Browser

TICKET_KEY = "t" * 32
SSH_HOST_KEY = "ssh-ed25519 AAAAhost"


def settings_of(mariadb, folder):
    host_keys = folder / "host_keys"
    host_keys.mkdir()
    (host_keys / "ssh_host_ed25519_key.pub").write_text(f"{SSH_HOST_KEY} root@sshd\n")
    return WebSettings(
        database=mariadb.settings("web"),
        tickets=TicketSettings(TICKET_KEY, 30),
        join=JoinSettings("approve", 3, None, (2222, 443), host_keys, allow_local_macs=True),
        site_address=SiteAddressSettings(None, 443, ("127.0.0.1", 1)),
        agent_files_dir=folder / "agent",
        secret_key="w" * 32,
        login_ttl_h=12,
        login_idle_h=4,
        log_level="info",
    )


@pytest.fixture
def web_settings(mariadb, tmp_path):
    return settings_of(mariadb, tmp_path)


@pytest.fixture(scope="session")
def made_app(mariadb, tmp_path_factory):
    """The application with its routes and compiled templates, which take longer than most tests."""
    return create_app(settings_of(mariadb, tmp_path_factory.mktemp("web")))


@pytest.fixture
def app(made_app, web_settings, database):
    """The application, with users and robots: ann drives sim1, olga observes it, root is admin."""
    with database.transaction() as tx:
        ann, olga = users.add(tx, "ann", HASH, "user"), users.add(tx, "olga", HASH, "user")
        users.add(tx, "root", HASH, "admin")
        sim1 = robots.add(tx, "02:00:00:00:51:01", "sim1")
        robots.add(tx, "02:00:00:00:51:02", "sim2")
        give(tx, ann, sim1, "drive")
        give(tx, olga, sim1, "observe")
    # All that a request leaves behind is in the database and here.
    made_app.extensions["robotether"] = make_context(web_settings)
    return made_app


@pytest.fixture
def browser(app):
    """A visitor without a login."""
    return Browser(app.test_client())


@pytest.fixture
def program(app):
    """A visitor without cookies."""
    return Browser(app.test_client(use_cookies=False))
