"""Grants that admins give and take."""

from __future__ import annotations

import pytest
from joins import Site
from robotether_server.db.audit import Source
from robotether_server.db.grants import Grant
from robotether_server.problems import RecordMissing
from robotether_server.services import grants

ADMIN = Source("root")


def test_grant_is_given_changed_and_taken(site: Site) -> None:
    """One a user and robot; each change is in the log."""
    with site.database.transaction() as tx:
        grants.grant(tx, ADMIN, "ann", "sim1", "observe")
        grants.grant(tx, ADMIN, "ann", "sim1", "manage")
        (given,) = grants.list_all(tx)
        assert given == Grant(given.id, "manage", user="ann", robot="sim1")
        grants.revoke(tx, ADMIN, "ann", "sim1")
        assert grants.list_all(tx) == []
        with pytest.raises(RecordMissing, match="user ann has no grant for robot sim1"):
            grants.revoke(tx, ADMIN, "ann", "sim1")
    assert (len(site.events("grant_given")), len(site.events("grant_taken"))) == (2, 1)


@pytest.mark.parametrize(("user", "robot"), [("ghost", "sim1"), ("ann", "ghost")])
def test_unknown_user_or_robot_is_said_so(site: Site, user: str, robot: str) -> None:
    """The sentence names which."""
    with site.database.transaction() as tx, pytest.raises(RecordMissing, match="ghost"):
        grants.grant(tx, ADMIN, user, robot, "drive")
