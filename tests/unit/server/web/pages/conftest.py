"""A manager who is not an admin, in a browser."""

import pytest
from granted import give
from robotether_server.db import robots, users
from web_visitor import HASH, Browser


@pytest.fixture
def manager(app, database):
    """May, who manages sim1, logged in; drivers there may publish /lights and call /dock."""
    policy = '{"policy": {"drive": {"publish": ["/lights"], "call": ["/dock"]}}}'
    with database.transaction() as tx:
        give(tx, users.add(tx, "may", HASH, "user"), robots.get(tx, "sim1").id, "manage")
        tx.change("UPDATE robots SET settings = %s WHERE name = 'sim1'", (policy,))
    browser = Browser(app.test_client())
    browser.log_in("may")
    return browser
