"""What lets a robot in: tokens of admins and join tokens, nothing else."""

from __future__ import annotations

import datetime as dt

import pytest
from joins import Site
from robotether_server.db import credentials, users
from robotether_server.problems import GrantMissing, TokenExpired, TokenInvalid
from robotether_server.services import enrolment_credentials

NOW = dt.datetime.now(dt.UTC)


def test_admins_token_names_the_admin(site: Site) -> None:
    """Another user's does not do."""
    with site.database.transaction() as tx:
        root, ann = users.get(tx, "root"), users.get(tx, "ann")
        credential = enrolment_credentials.find(tx, credentials.create_token(tx, root, "a", None))
        assert (credential.actor, credential.admin, credential.token) == ("root", root, None)
        assert credential.details == {"by": "admin"}
        with pytest.raises(GrantMissing, match="must be an admin's"):
            enrolment_credentials.find(tx, credentials.create_token(tx, ann, "a", None))


def test_join_token_holds_until_its_time_is_over(site: Site) -> None:
    """Also when it is used up: it still tells who asks."""
    with site.database.transaction() as tx:
        text = credentials.create_join_token(tx, "lab", 1, NOW + dt.timedelta(hours=1), "root")
        credential = enrolment_credentials.find(tx, text)
        assert credential.token is not None
        assert (credential.actor, credential.details) == (
            "robot",
            {"by": "join token", "token": "lab"},
        )
        credentials.use_join_token(tx, credential.token.id, "SHA256:a")
        assert enrolment_credentials.find(tx, text).token is not None
        over = credentials.create_join_token(tx, "over", 1, NOW - dt.timedelta(hours=1), "root")
        with pytest.raises(TokenExpired):
            enrolment_credentials.find(tx, over)


@pytest.mark.parametrize("text", ["rj_nobodys", "rt_nobodys", "", "x"])
def test_unknown_token_is_refused(site: Site, text: str) -> None:
    """Without a word on whether there are others."""
    with site.database.transaction() as tx, pytest.raises(TokenInvalid):
        enrolment_credentials.find(tx, text)
