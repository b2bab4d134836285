"""People and robots in the real database, for what admins do."""

import pytest
from joins import KEY, MAC, REPORT, Site
from robotether_server.db import robots, users


@pytest.fixture
def site(database):
    """A server with admin root, user ann and robot sim1, which is active with KEY."""
    site = Site(database)
    with database.transaction() as tx:
        users.add(tx, "root", "x", "admin")
        users.add(tx, "ann", "x", "user")
        robot_id = robots.add(tx, MAC, "sim1")
        robots.set_key(tx, robot_id, KEY, REPORT)
        robots.set_state(tx, robot_id, "active")
    return site
