"""The application of web with people and robots in the real database, and its visitors."""

from __future__ import annotations

import pytest
from flask import Flask
from granted import give
from robotether_server.settings import WebSettings
from robotether_server.store import Database, robots, users
from robotether_server.web import create_app
from web_visitor import HASH, Browser


@pytest.fixture
def app(web_settings: WebSettings, database: Database) -> Flask:
    """The application, with users and robots: ann drives sim1, olga observes it, root is admin."""
    with database.transaction() as tx:
        ann, olga = users.add(tx, "ann", HASH, "user"), users.add(tx, "olga", HASH, "user")
        users.add(tx, "root", HASH, "admin")
        sim1 = robots.add(tx, "02:00:00:00:51:01", "sim1")
        robots.add(tx, "02:00:00:00:51:02", "sim2")
        give(tx, ann, sim1, "drive")
        give(tx, olga, sim1, "observe")
    return create_app(web_settings)


@pytest.fixture
def browser(app: Flask) -> Browser:
    """A visitor without a login."""
    return Browser(app.test_client())


@pytest.fixture
def program(app: Flask) -> Browser:
    """A visitor without cookies."""
    return Browser(app.test_client(use_cookies=False))
