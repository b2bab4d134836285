"""The application of web with people and robots in the real database, and who visits it."""

import pytest
from granted import give
from robotether_server.db import robots, users
from robotether_server.web import create_app
from robotether_server.web.app import make_context
from web_visitor import HASH, Browser, web_settings_of, write_host_key


@pytest.fixture
def web_settings(mariadb, tmp_path):
    write_host_key(tmp_path)
    return web_settings_of(mariadb.settings("web"), tmp_path)


@pytest.fixture(scope="session")
def made_app(mariadb, tmp_path_factory):
    """The application with its routes and compiled templates, which take longer than most tests."""
    return create_app(web_settings_of(mariadb.settings("web"), tmp_path_factory.mktemp("web")))


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
